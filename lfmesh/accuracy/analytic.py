"""Sequential trace through the analytic surfaces, without meshes: the truth that the tracer is measured against.

It shares no code with the engine. Surfaces are met by Welford's transfer formulae (Aberrations of Optical Systems,
1986, chapter 4) and, with aspheric terms, Newton's method from there; bending is Snell's law in vector form, weights
are Fresnel's transmittances. It works in any of numpy's floating types: the difference between float64 and extended
precision is the truth's own error.

Camera frame throughout: z along the axis from object to sensor, origin at the first vertex, mm.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.array.lenslets import lenslets
from lfmesh.optics.glass import AIR, refractive_index
from lfmesh.scene import BackFace, Lens, Scene, solved

Array = NDArray[np.floating[Any]]

NEWTON_STEPS = 30

CELL_STEPS = 6
"""Lenslets tried in turn: a ray may meet its neighbour's cap before the one that its first guess lies in."""


@dataclass(frozen=True)
class Interface:
    """One surface of the prescription at one wavelength; a pure stop has the same index on both sides."""

    vertex_z: float
    curvature: float
    conic: float
    asphere: tuple[float, ...]
    aperture: float
    index_before: float
    index_after: float
    turn: NDArray[np.float64] | None = None
    """Rotation of a posed element, and where the origin goes; None: the surface stands as prescribed."""
    origin: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    thin_power: float = 0.0
    """Of a thin lens in place of an interface, 1/mm."""
    odd: tuple[float, ...] = ()
    """Coefficients of r³, r⁵, ..."""


@dataclass(frozen=True)
class Landing:
    """Rays on the sensor's plane.

    Attributes
    ----------
    position : (n, 2) float, mm
        x and y in the sensor's frame; NaN for a ray that does not arrive.
    weight : (n,) float
        Share of the ray's power that is left: the product of Fresnel's transmittances.
    arrives : (n,) bool
        False for a ray that an aperture stops, that misses a surface, or that is reflected totally.
    """

    position: Array
    weight: Array
    arrives: NDArray[np.bool_]


@dataclass
class Rays:
    """A bundle under way."""

    p: Array
    d: Array
    weight: Array
    alive: NDArray[np.bool_]


@dataclass(frozen=True)
class LensletArray:
    """The microlens array: every lenslet's face, and where the array stands.

    Attributes
    ----------
    turn : (3, 3) float64, origin : (3,) float64
        Of the frame whose z runs from the curved face into the glass.
    curvature : (rows, columns) float64, 1/mm
    apex : (rows, columns, 2) float64, mm
    centre : (rows, columns, 2) float64, mm
    conic : (rows, columns) float64
    terms : (rows, columns, n) float64
        Coefficients of r⁴, r⁶, ...
    bends : (2,) float64
        1 for each of x and y, but 0 for that along cylinders.
    back : LensletArray or None
        Lenslets on the other face, in a frame of their own, which looks the other way.
    """

    turn: NDArray[np.float64]
    origin: NDArray[np.float64]
    curved_to_lens: bool
    index: float
    thickness: float
    hexagonal: bool
    pitch: float
    curvature: NDArray[np.float64]
    apex: NDArray[np.float64]
    centre: NDArray[np.float64]
    conic: NDArray[np.float64]
    terms: NDArray[np.float64]
    bends: NDArray[np.float64]
    back: "LensletArray | None" = None

    @property
    def spherical(self) -> bool:
        """True if all lenslets are spheres."""
        return not self.conic.any() and not self.terms.any() and bool(self.bends.all())


@dataclass(frozen=True)
class Camera:
    """Everything on a ray's way from the first vertex to the sensor, at one wavelength."""

    interfaces: tuple[Interface, ...]
    mla: LensletArray | None
    sensor_turn: NDArray[np.float64]
    sensor_origin: NDArray[np.float64]
    precision: type = field(default=np.float64)

    @classmethod
    def of(cls, scene: Scene, wavelength_nm: float, precision: type = np.float64) -> "Camera":
        """Return the camera of a scene at one wavelength.

        Parameters
        ----------
        scene : Scene
        wavelength_nm : float, nm
        precision : type
            Of all numbers: `numpy.float64` or `numpy.longdouble`.

        Raises
        ------
        LfmeshError
            A surface of the lens is a mesh from a file: it has no analytic truth.
        """
        scene = solved(scene)
        lens, camera = scene.camera.lens, scene.camera
        interfaces, before = [], AIR
        for i, (surface, z) in enumerate(zip(lens.surfaces, lens.vertices_mm, strict=True)):
            if surface.mesh is not None:
                raise LfmeshError(
                    f"camera.lens.surfaces[{i}]: a mesh from a file has no analytic surface to measure its error "
                    "against; give a lens with radii"
                )
            if surface.section_key is not None:
                raise LfmeshError(
                    f"camera.lens.surfaces[{i}].{surface.section_key}: the truth that errors are measured against has "
                    "surfaces of revolution alone"
                )
            after = refractive_index(surface.medium, wavelength_nm)
            interfaces.append(
                Interface(
                    z, surface.curvature_per_mm, surface.vertex_conic, surface.terms_mm,
                    surface.semi_diameter_mm or np.inf, before, after, *_placed(lens, i),
                    surface.thin_lens_power_per_mm, surface.odd_asphere_mm,
                )
            )  # fmt: skip
            before = after
        z = lens.vertices_mm[-1]
        mla = None
        if camera.mla is not None:
            z += camera.mla.distance_mm or 0.0
            mla = _lenslet_array(scene, z, wavelength_nm)
            z += camera.mla.thickness_mm
        pose = camera.sensor.pose
        origin = np.add([0.0, 0.0, z + (camera.sensor.distance_mm or 0.0)], pose.shift_mm)
        return cls(tuple(interfaces), mla, _turned(pose.tilt_deg), origin, precision)

    def land(self, origins: ArrayLike, directions: ArrayLike) -> Landing:
        """Trace rays from object space to the sensor's plane.

        Parameters
        ----------
        origins, directions : (n, 3) float
            Camera frame; every ray starts before the first surface and runs towards +z.
        """
        kind = self.precision
        d: Array = np.array(directions, dtype=kind)
        d /= np.sqrt((d * d).sum(axis=1))[:, None]
        rays = Rays(np.array(origins, dtype=kind), d, np.ones(len(d), kind), np.ones(len(d), np.bool_))
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for interface in self.interfaces:
                _through_surface(rays, interface)
            if self.mla is not None:
                _through_mla(rays, self.mla)
            p, d = _into_frame(rays, self.sensor_turn, self.sensor_origin)
            landed = p[:, :2] - (p[:, 2] / d[:, 2])[:, None] * d[:, :2]
            rays.alive &= (d[:, 2] > 0) & np.isfinite(landed).all(axis=1)
        landed[~rays.alive] = np.nan
        return Landing(landed, np.where(rays.alive, rays.weight, 0), rays.alive)


def own_error(scene: Scene, wavelength_nm: float, origins: ArrayLike, directions: ArrayLike) -> float | None:
    """Return the largest difference in mm between the truth in float64 and in extended precision.

    None on a platform whose long double is a float64.

    Parameters
    ----------
    scene : Scene
    wavelength_nm : float, nm
    origins, directions : (n, 3) float64
        As `Camera.land` takes them.
    """
    if np.finfo(np.longdouble).eps >= np.finfo(np.float64).eps:
        return None
    plain = Camera.of(scene, wavelength_nm).land(origins, directions)
    fine = Camera.of(scene, wavelength_nm, np.longdouble).land(origins, directions)
    both = plain.arrives & fine.arrives
    difference = plain.position[both] - fine.position[both]
    shift = np.sqrt((difference * difference).sum(axis=1))
    return float(shift.max(initial=0.0))


def _turned(tilt_deg: ArrayLike) -> NDArray[np.float64]:
    """Return the rotation about x, then y, then z."""
    a, b, c = np.deg2rad(np.asarray(tilt_deg, dtype=np.float64))
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def _placed(lens: Lens, number: int) -> tuple[NDArray[np.float64] | None, NDArray[np.float64]]:
    """Return rotation and shifted origin of a surface by the pose of its element; no rotation where it has none."""
    which = lens.element_of(number)
    if which is None:
        return None, np.zeros(3)
    element = lens.elements[which]
    turn, pivot = _turned(element.pose.tilt_deg), np.array([0.0, 0.0, lens.vertices_mm[element.surfaces[0]]])
    return turn, pivot - turn @ pivot + element.pose.shift_mm


def _into_frame(rays: Rays, turn: NDArray[np.float64], origin: NDArray[np.float64]) -> tuple[Array, Array]:
    """Return positions and directions in a frame that stands at `origin`, turned by `turn`."""
    kind = rays.p.dtype
    # Columns of the turn are the frame's axes: a row vector times it has the frame's coordinates.
    axes = turn.astype(kind)
    return (rays.p - origin.astype(kind)) @ axes, rays.d @ axes


def _outof_frame(p: Array, d: Array, turn: NDArray[np.float64], origin: NDArray[np.float64]) -> tuple[Array, Array]:
    back = turn.astype(p.dtype).T
    return p @ back + origin.astype(p.dtype), d @ back


def _through_surface(rays: Rays, s: Interface) -> None:
    """Transfer the rays to a surface, stop those outside its aperture, and refract the rest."""
    kind = rays.p.dtype.type
    if s.turn is not None:
        rays.p, rays.d = _into_frame(rays, s.turn, s.origin)
    p = rays.p - np.array([0, 0, s.vertex_z], kind)
    t = _conic_transfer(p, rays.d, kind(s.curvature), kind(s.conic))
    if any(s.asphere) or any(s.odd):
        t = _asphere_transfer(p, rays.d, s, t)
    p = p + t[:, None] * rays.d
    r2 = p[:, 0] ** 2 + p[:, 1] ** 2
    rays.alive &= r2 <= kind(s.aperture) ** 2
    g = 2 * _sag_rate(s, r2)
    normal = np.stack([-g * p[:, 0], -g * p[:, 1], np.ones_like(g)], axis=1)
    rays.p = p + np.array([0, 0, s.vertex_z], kind)
    if s.index_before != s.index_after:
        _refract(rays, normal, s.index_before, s.index_after)
    if s.thin_power:
        slopes = rays.d[:, :2] / rays.d[:, 2:] - kind(s.thin_power) * p[:, :2]
        rays.d = np.column_stack([slopes, np.ones_like(t)]) / np.sqrt(1 + (slopes * slopes).sum(axis=1))[:, None]
    if s.turn is not None:
        rays.p, rays.d = _outof_frame(rays.p, rays.d, s.turn, s.origin)


def _conic_transfer(p: Array, d: Array, c: Any, k: Any) -> Array:
    """Return the distance from p to the conic's sheet through the origin (Welford's 4.10, generalised)."""
    # To the vertex's plane first: what follows is then small, and keeps its digits.
    to_plane = -p[:, 2] / d[:, 2]
    x, y = p[:, 0] + to_plane * d[:, 0], p[:, 1] + to_plane * d[:, 1]
    f = c * (x * x + y * y)
    g = d[:, 2] - c * (d[:, 0] * x + d[:, 1] * y)
    return to_plane + f / (g + np.sqrt(g * g - c * f * (1 + k * d[:, 2] ** 2)))


def _sag(s: Interface, r2: Array) -> Array:
    kind = r2.dtype.type
    c, k = kind(s.curvature), kind(s.conic)
    z = c * r2 / (1 + np.sqrt(1 - (1 + k) * c * c * r2))
    for j, a in enumerate(s.asphere):
        z = z + kind(a) * r2 ** (j + 2)
    for j, b in enumerate(s.odd):
        z = z + kind(b) * np.sqrt(r2) * r2 ** (j + 1)
    return z


def _sag_rate(s: Interface, r2: Array) -> Array:
    """Return d sag / d r²."""
    kind = r2.dtype.type
    c, k = kind(s.curvature), kind(s.conic)
    rate = c / (2 * np.sqrt(1 - (1 + k) * c * c * r2))
    for j, a in enumerate(s.asphere):
        rate = rate + (j + 2) * kind(a) * r2 ** (j + 1)
    for j, b in enumerate(s.odd):
        rate = rate + kind(j + 1.5) * kind(b) * np.sqrt(r2) * r2**j
    return rate


def _asphere_transfer(p: Array, d: Array, s: Interface, t: Array) -> Array:
    """Improve the conic's distance by Newton's method until every ray has settled."""
    for _ in range(NEWTON_STEPS):
        q = p + t[:, None] * d
        r2 = q[:, 0] ** 2 + q[:, 1] ** 2
        rate = d[:, 2] - 2 * _sag_rate(s, r2) * (q[:, 0] * d[:, 0] + q[:, 1] * d[:, 1])
        step = (q[:, 2] - _sag(s, r2)) / rate
        t = t - step
        if not np.any(np.abs(step) > 4 * np.finfo(t.dtype).eps * (1 + np.abs(t))):
            break
    return t


def _refract(rays: Rays, normal: Array, before: float, after: float) -> None:
    """Bend the rays by Snell's law, n' d' − n d parallel to the normal, and weigh them by Fresnel's transmittance."""
    kind = rays.d.dtype.type
    n_i, n_t = kind(before), kind(after)
    normal = normal / np.sqrt((normal * normal).sum(axis=1))[:, None]
    a_i = n_i * (rays.d * normal).sum(axis=1)
    square = n_t * n_t - n_i * n_i + a_i * a_i
    rays.alive &= (a_i > 0) & (square > 0)
    a_t = np.sqrt(square)
    bent = n_i * rays.d + (a_t - a_i)[:, None] * normal
    rays.d = bent / np.sqrt((bent * bent).sum(axis=1))[:, None]
    cos_i, cos_t = a_i / n_i, a_t / n_t
    t_s = 2 * n_i * cos_i / (n_i * cos_i + n_t * cos_t)
    t_p = 2 * n_i * cos_i / (n_t * cos_i + n_i * cos_t)
    rays.weight = rays.weight * (n_t * cos_t) / (n_i * cos_i) * (t_s * t_s + t_p * t_p) / 2


def _lenslet_array(scene: Scene, face_z: float, wavelength_nm: float) -> LensletArray:
    mla = scene.camera.mla
    assert mla is not None
    lattice = Lattice(
        mla.layout == "hexagonal", mla.pitch_mm * (1.0 + mla.form.pitch_error), mla.count[0], mla.count[1]
    )
    # What the form errors are is data, drawn from the scene's seed; what rays do there is worked out here.
    drawn = lenslets(
        lattice, np.asarray(mla.radius_mm, np.float64), mla.thickness_mm,
        decenter_mm=mla.form.decenter_mm, radius_error=mla.form.radius_error, seed=mla.form.seed,
        conic=mla.conic, asphere_mm=mla.asphere_mm, cylinder_axis=mla.cylinder_axis,
    )  # fmt: skip
    row, column = np.indices((lattice.rows, lattice.columns))
    kinds = mla.types
    if kinds == 1:
        kind = np.zeros_like(row)
    elif mla.cylinder_axis is not None:
        kind = (column if mla.cylinder_axis == "y" else row) % kinds
    elif lattice.hexagonal:
        kind = (column - row // 2 + 2 * row) % 3 if kinds == 3 else (column + row) % 2
    else:
        kind = (column + row) % kinds
    curvature = 1.0 / np.asarray(mla.radius_mm, np.float64)[kind]
    centre = lattice.centres()
    apex = centre.copy()
    if len(drawn.stretch):
        curvature = curvature * drawn.stretch.reshape(curvature.shape)
    if len(drawn.decentre):
        apex = apex + drawn.decentre.reshape(apex.shape)
    turn = _turned(mla.pose.tilt_deg)
    origin = np.add([0.0, 0.0, face_z], mla.pose.shift_mm)
    to_lens = mla.curved_side == "lens"
    if not to_lens:
        # The curved face stands at the far side, and its own z looks back.
        origin = origin + turn @ [0.0, 0.0, mla.thickness_mm]
        turn = turn @ np.diag([1.0, 1.0, -1.0])
    index = refractive_index(mla.medium, wavelength_nm)
    profiles = [mla.profile_of(k) for k in range(kinds)]
    terms = np.zeros((kinds, max(len(given) for _, given in profiles)))
    for own, (_, given) in zip(terms, profiles, strict=True):
        own[: len(given)] = given
    face = LensletArray(
        turn, origin, to_lens, index, mla.thickness_mm, lattice.hexagonal, lattice.pitch, curvature, apex, centre,
        np.array([conic for conic, _ in profiles])[kind], terms[kind],
        np.array([mla.cylinder_axis != "x", mla.cylinder_axis != "y"], np.float64),
    )  # fmt: skip
    return face if mla.back is None else replace(face, back=_other_face(face, mla.back))


def _other_face(face: LensletArray, back: BackFace) -> LensletArray:
    """Return the lenslets on the other face, all alike, in their own frame."""
    alike = np.ones(face.curvature.shape)
    return replace(
        face,
        turn=face.turn @ np.diag([1.0, 1.0, -1.0]),
        origin=face.origin + face.turn @ [*back.decenter_mm, face.thickness],
        curvature=alike / back.radius_mm,
        apex=face.centre,
        conic=back.conic * alike,
        terms=np.multiply.outer(alike, np.array(back.asphere_mm or (0.0,))),
        bends=np.array([back.cylinder_axis != "x", back.cylinder_axis != "y"], np.float64),
    )


def _through_mla(rays: Rays, mla: LensletArray) -> None:
    """Take the rays through both faces of the array, in whichever order they come."""
    if mla.back is not None:
        order = (mla, mla.back) if mla.curved_to_lens else (mla.back, mla)
        for face, (before, after) in zip(order, ((AIR, mla.index), (mla.index, AIR)), strict=True):
            rays.p, rays.d = _into_frame(rays, face.turn, face.origin)
            _through_lenslets(rays, face, before, after)
            rays.p, rays.d = _outof_frame(rays.p, rays.d, face.turn, face.origin)
        return
    rays.p, rays.d = _into_frame(rays, mla.turn, mla.origin)
    if mla.curved_to_lens:
        _through_lenslets(rays, mla, AIR, mla.index)
        _through_flat_face(rays, mla, mla.index, AIR)
    else:
        _through_flat_face(rays, mla, AIR, mla.index)
        _through_lenslets(rays, mla, mla.index, AIR)
    rays.p, rays.d = _outof_frame(rays.p, rays.d, mla.turn, mla.origin)


def _through_flat_face(rays: Rays, mla: LensletArray, before: float, after: float) -> None:
    kind = rays.p.dtype.type
    t = (kind(mla.thickness) - rays.p[:, 2]) / rays.d[:, 2]
    rays.p = rays.p + t[:, None] * rays.d
    # Between the faces a ray may leave through the array's edge.
    rays.alive &= _nearest_cell(mla, rays.p) >= 0
    along = np.sign(rays.d[:, 2])
    _refract(rays, np.stack([np.zeros_like(t), np.zeros_like(t), along], axis=1), before, after)


def _through_lenslets(rays: Rays, mla: LensletArray, before: float, after: float) -> None:
    """Refract the rays at the face of the lenslet in whose cell they meet it.

    A ray whose cell does not settle crosses the wall between unlike lenslets; it is left out.
    """
    kind = rays.p.dtype.type
    to_apexes = -rays.p[:, 2] / rays.d[:, 2]
    at = rays.p + to_apexes[:, None] * rays.d
    cell = _nearest_cell(mla, at)
    settled = np.zeros(len(cell), np.bool_)
    for _ in range(CELL_STEPS):
        flat = np.maximum(cell, 0)
        apex = mla.apex.reshape(-1, 2)[flat].astype(kind)
        c = mla.curvature.reshape(-1)[flat].astype(kind)
        p = np.column_stack([rays.p[:, :2] - apex, rays.p[:, 2]])
        if mla.spherical:
            t = _conic_transfer(p, rays.d * np.sign(rays.d[:, 2:]), c, kind(0)) * np.sign(rays.d[:, 2])
        else:
            t = _profile_transfer(p, rays.d, mla, flat, c)
        q = p + t[:, None] * rays.d
        hit = np.column_stack([q[:, :2] + apex, q[:, 2]])
        there = _nearest_cell(mla, hit)
        settled = (there == cell) & (cell >= 0)
        if settled.all():
            break
        cell = there
    rays.alive &= settled
    rays.p = hit
    normal = np.column_stack([-c[:, None] * q[:, :2], 1 - c * q[:, 2]])
    if not mla.spherical:
        normal = np.column_stack([-_profile(mla, flat, c, q)[1], np.ones_like(c)])
    normal = normal * np.sign(rays.d[:, 2:])
    _refract(rays, normal, before, after)


def _profile(mla: LensletArray, cell: NDArray[np.int64], c: Array, q: Array) -> tuple[Array, Array]:
    """Return the sag and the slopes (n, 2) of lenslets that are no spheres, at points from their apexes."""
    kind = q.dtype.type
    across = q[:, :2] * mla.bends.astype(kind)
    r2 = (across * across).sum(axis=1)
    root = np.sqrt(1 - (1 + mla.conic.reshape(-1)[cell].astype(kind)) * c * c * r2)
    sag, steep = c * r2 / (1 + root), c / root
    for j, a in enumerate(mla.terms.reshape(mla.conic.size, mla.terms.shape[-1])[cell].astype(kind).T):
        sag = sag + a * r2 ** (j + 2)
        steep = steep + (2 * j + 4) * a * r2 ** (j + 1)
    return sag, steep[:, None] * across


def _profile_transfer(p: Array, d: Array, mla: LensletArray, cell: NDArray[np.int64], c: Array) -> Array:
    """Return the distances to the faces of lenslets that are no spheres, by Newton's method from the apexes."""
    t = -p[:, 2] / d[:, 2]
    for _ in range(NEWTON_STEPS):
        q = p + t[:, None] * d
        sag, slopes = _profile(mla, cell, c, q)
        step = (q[:, 2] - sag) / (d[:, 2] - (slopes * d[:, :2]).sum(axis=1))
        t = t - step
        if not np.any(np.abs(step) > 4 * np.finfo(t.dtype).eps * (1 + np.abs(t))):
            break
    return np.asarray(t)


def _nearest_cell(mla: LensletArray, p: Array) -> NDArray[np.int64]:
    """Return the number of the cell whose centre is nearest to each point; −1 outside the array."""
    rows, columns = mla.curvature.shape
    x, y = p[:, 0].astype(np.float64) / mla.pitch, p[:, 1].astype(np.float64) / mla.pitch
    far = 2.0 * (rows + columns)
    x, y = (np.nan_to_num(a, nan=far, posinf=far, neginf=far) for a in (x, y))
    spacing = np.sqrt(0.75) if mla.hexagonal else 1.0
    first = mla.centre[0, 0] / mla.pitch
    middle = np.rint((y - first[1]) / spacing)
    nearest = np.full(len(p), np.inf)
    best_row, best_column = middle.copy(), np.zeros_like(middle)
    for row in (middle - 1, middle, middle + 1) if mla.hexagonal else (middle,):
        start = first[0] + (0.5 * np.mod(row, 2) if mla.hexagonal else 0.0)
        column = np.rint(x - start)
        distance = (x - start - column) ** 2 + (y - first[1] - row * spacing) ** 2
        nearer = distance < nearest
        nearest = np.where(nearer, distance, nearest)
        best_row, best_column = np.where(nearer, row, best_row), np.where(nearer, column, best_column)
    inside = (best_row >= 0) & (best_row < rows) & (best_column >= 0) & (best_column < columns)
    return np.where(inside, best_row * columns + best_column, -1).astype(np.int64)
