"""Recognition of the exact lens surface, about the z axis, that a face of a solid lies on.

A STEP file gives planes, spheres, cylinders and tori by name, and swept curves and nets as points to be fitted. For a
mesh, spheres are fitted to the vertices. If a candidate deviates from the face's vertices by more than its bound, the
face stays a mesh.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame
from lfmesh.geometry.files.swept import Outside, curve_in_box, net_in_box
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.surfaces.profile_fit import Profile, fitted_profile
from lfmesh.geometry.surfaces.sag import heights, normals
from lfmesh.geometry.surfaces.surface import surface_of
from lfmesh.scene import Surface
from lfmesh.scene.camera.sections import Toroid
from lfmesh.scene.literals import plain

ON_SURFACE = 1e-6
"""Largest distance of a vertex from its surface, over the farthest coordinate: float32 rounding and a margin."""

ON_AXIS = 1e-9
"""Tilt in rad below which a plane is perpendicular to z, or an axis parallel to it: rounding of CAD programs."""

EXACT_MM = 1e-7
"""Largest distance of a swept curve's points from the conic with even terms that replaces it, mm."""

FITTED_MM = 1e-5
"""Largest distance of a mesh's vertices from the sphere that replaces them, mm."""

FORM_MM = 3e-6
"""Largest value of the smooth part of these distances, mm: of a polynomial of degree 4 in x and y fitted to them, and
of their means over neighbouring vertices. The distances of an asphere or a dent are smooth; those due to missing digits
in a file are not, and do not affect rays."""

NEIGHBOURS = 16
"""Number of vertices, including itself, over which the distance of a vertex is averaged."""

DEGREE = 4
"""Degree of that polynomial."""

VERTICES_A_TERM = 2
"""Least number of vertices for each term of a fit."""

INDEPENDENT = 1e-3
"""Least ratio of the singular values of the terms at the vertices for a unique fit."""

BESIDE = 1e-3
"""Largest distance outside a face's box at which a swept curve is sampled, over the face's radius."""

MOST_FITTED = 8
"""Most swept surfaces fitted to a face: a file may hold any number, and each fit takes time."""

NO_TURN = 1e-12
"""Azimuth in rad below which it is rounding in the file."""


@dataclass(frozen=True)
class Told:
    """A surface given by a STEP file.

    Attributes
    ----------
    surface : dict
        As written by `step_surfaces`, mm.
    place : (3, 4) float64
        Frame of its body in the file.
    """

    surface: dict[str, Any]
    place: frame.Frame


@dataclass(frozen=True)
class Form:
    """An exact surface, about the z axis of the file.

    Attributes
    ----------
    vertex_z : float, mm
    keys : dict
        Keys of the lens's `Surface`: radius and other shape parameters.
    azimuth_deg : float
        Rotation of a cylinder or toroid about z.
    words : str
        Description of the surface and of the quality of the fit.
    """

    vertex_z: float
    keys: dict[str, Any] = field(default_factory=dict)
    azimuth_deg: float = 0.0
    words: str = ""

    def distances(self, points: Array) -> Array:
        """Return the distances of points (n, 3) from it, mm; NaN where it does not reach."""
        record = surface_of(Surface(**self.keys))
        x, y, z = frame.points(frame.inverse(frame.frame((0.0, 0.0, self.azimuth_deg))), points).T
        with np.errstate(invalid="ignore"):
            return np.asarray(np.abs(z - self.vertex_z - heights(record, x, y)) * normals(record, x, y)[:, 2])


def told_form(points: Array, told: list[Told]) -> tuple[Form | None, str]:
    """Return the first surface in a STEP file that a face lies on, or the reason why there is none.

    Parameters
    ----------
    points : (n, 3) float64, mm
        Vertices of the face.
    told : list of Told
    """
    largest = ON_SURFACE * float(np.abs(points).max())
    nearest, fitted = np.inf, 0
    for each in told:
        if fitted == MOST_FITTED:
            break
        try:
            # Absurdly large or small values overflow; such a surface does not fit this face.
            with np.errstate(all="ignore"):
                candidates = list(_forms(each, points))
                fitted += len(candidates) * ("curve" in each.surface or "points" in each.surface)
                # The surface must reach every vertex: comparisons with NaN are false.
                matching = [each for each in candidates if each[0].distances(points).max() <= max(largest, each[1])]
        except (LfmeshError, np.linalg.LinAlgError):
            # A radius or coefficient beyond what a lens may have.
            continue
        for form, residual in matching:
            if residual <= EXACT_MM:
                return form, ""
            nearest = min(nearest, residual)
    if np.isfinite(nearest):
        off = plain(nearest, 2)
        return None, f"the nearest conic with even terms is {off} mm off its curve; the limit is {EXACT_MM:g} mm"
    return None, "no surface of the file around the z axis contains all its vertices"


def _forms(told: Told, points: Array) -> Iterator[tuple[Form, float]]:
    """Yield the lens surfaces that a surface of the file may be at the face, and their residuals."""
    surface = told.surface
    kind = surface["kind"]
    axis = told.place[:, :3] @ np.asarray(surface.get("axis", (0.0, 0.0, 1.0)))
    at = frame.points(told.place, [surface.get("at", (0.0, 0.0, 0.0))])[0]
    if kind == "net":
        yield from _revolved(net_in_box(surface, told.place, _box(points)), points, kind)
    elif kind == "plane" and np.hypot(*axis[:2]) <= ON_AXIS:
        vertex = float(at[2] + axis[:2] @ at[:2] / axis[2])
        yield Form(vertex, {"radius_mm": np.inf}, words="a plane of the file"), 0.0
    elif kind == "sphere" and np.hypot(*at[:2]) <= ON_AXIS * surface["radius"]:
        # Take the half of the sphere that the face is on; the centre of the lower half lies towards +z.
        radius = _signed(surface["radius"], at[2] - points[:, 2].mean())
        yield Form(at[2] - radius, {"radius_mm": radius}, words=f"a sphere of the file, radius {radius:.9g} mm"), 0.0
    elif kind == "revolution" and np.hypot(*axis[:2]) <= ON_AXIS and np.hypot(*at[:2]) <= ON_AXIS * _size(points):
        yield from _revolved(curve_in_box(surface["curve"], told.place, _box(points)), points, "curve turned about z")
    elif kind in ("cylinder", "torus", "revolution", "extrusion") and abs(axis[2]) <= ON_AXIS:
        yield from _sectioned(told, at, axis, points)


def _signed(radius: float, towards: float) -> float:
    return float(np.copysign(radius, towards))


def _size(points: Array) -> float:
    """Return the largest distance of a face from the z axis, mm."""
    return float(np.hypot(points[:, 0], points[:, 1]).max())


def _box(points: Array) -> Outside:
    """Return the box of a face, in distance from the axis and height."""
    size, low, high = _size(points), points[:, 2].min(), points[:, 2].max()
    return lambda p: _outside(np.hypot(p[:, 0], p[:, 1]), p[:, 2], size, low, high)


def _outside(r: Array, z: Array, size: float, low: float, high: float) -> Array:
    """Return the distance of points, given by r and z, from a face's box, mm; 0 inside and close to it."""
    beside = BESIDE * size
    above = np.maximum(np.maximum(low - beside - z, z - high - beside), 0.0)
    return np.asarray(np.hypot(np.maximum(r - size - beside, 0.0), above))


def _thinned(points: Array) -> Array:
    """Return about 500 of many points."""
    return points[:: max(1, len(points) // 500)]


def _revolved(sample: Array, points: Array, what: str) -> Iterator[tuple[Form, float]]:
    """Yield the surface of revolution through the sampled points of a curve or net."""
    some = _thinned(sample)
    profile = fitted_profile(np.hypot(some[:, 0], some[:, 1]), some[:, 2]) if len(some) else None
    if profile is not None:
        reaching = max(_size(points), _size(some))
        yield Form(profile.vertex_mm, _keys(profile), words=_in_words(profile, what)), _off(profile, sample, reaching)


def _off(profile: Profile, sample: Array, reaching: float) -> float:
    """Return the largest distance, along z, of all sampled points from a profile fitted to some of them."""
    record = surface_of(Surface(**_keys(profile)))
    with np.errstate(invalid="ignore"):
        on_profile = heights(record, np.hypot(sample[:, 0], sample[:, 1]), np.zeros(len(sample)))
    off = np.abs(on_profile + profile.vertex_mm - sample[:, 2])
    return float(np.nan_to_num(off, nan=reaching).max())


def _keys(profile: Profile) -> dict[str, Any]:
    keys: dict[str, Any] = {"radius_mm": profile.radius_mm}
    if profile.conic:
        keys["conic"] = profile.conic
    if any(profile.terms_mm):
        keys["asphere_mm"] = profile.terms_mm
    return keys


def _in_words(profile: Profile, what: str) -> str:
    terms = f", conic {profile.conic:.6g}" if profile.conic else ""
    terms += f", {len(profile.terms_mm)} even terms" if profile.terms_mm else ""
    return f"a {what} of the file: radius {profile.radius_mm:.9g} mm{terms}; within {plain(profile.residual_mm, 1)} mm"


def _sectioned(told: Told, at: Array, axis: Array, points: Array) -> Iterator[tuple[Form, float]]:
    """Yield the lens cylinders and toroids that a surface with an axis perpendicular to z may be."""
    surface, kind = told.surface, told.surface["kind"]
    along = np.array([axis[0], axis[1], 0.0]) / np.hypot(axis[0], axis[1])
    across = np.array([-along[1], along[0], 0.0])
    if kind != "extrusion" and abs(at @ across) > ON_AXIS * _size(points):
        return
    middle = float(at[2])
    if kind == "cylinder":
        radius = _signed(surface["radius"], middle - points[:, 2].mean())
        words = f"a cylinder of the file, radius {radius:.9g} mm"
        yield _turned(middle - radius, {"radius_mm": np.inf}, along, radius, words), 0.0
        return
    if kind == "torus":
        if abs(at @ along) > ON_AXIS * _size(points):
            return
        for ring in (-surface["radius"], surface["radius"]):
            for tube in (-surface["tube"], surface["tube"]):
                # Signed radii point from the vertex to the tube's centre and to the axis.
                if ring != tube:
                    words = f"a torus of the file, radii {tube:.9g} and {tube - ring:.9g} mm"
                    yield _turned(middle + ring - tube, {"radius_mm": tube}, along, tube - ring, words), 0.0
        return
    y, low, high = points @ (along if kind == "revolution" else across), points[:, 2].min(), points[:, 2].max()
    size, sense = float(np.abs(y).max()), _signed(1.0, middle - points[:, 2].mean())

    def section(p: Array) -> Array:
        """Return y and z (n, 2) of points, carried by the axis into the section through it."""
        if kind == "extrusion":
            return np.column_stack([p @ across, p[:, 2]])
        return np.column_stack([p @ along, middle - sense * np.hypot(p @ across, p[:, 2] - middle)])

    def outside(p: Array) -> Array:
        at_y, at_z = section(p).T
        return _outside(np.abs(at_y), at_z, size, low, high)

    sample = section(curve_in_box(surface["curve"], told.place, outside))
    some = _thinned(sample)
    profile = fitted_profile(np.abs(some[:, 0]), some[:, 1]) if len(some) else None
    if profile is None:
        return
    off = _off(profile, np.column_stack([sample[:, 0], 0.0 * sample[:, 0], sample[:, 1]]), size)
    words = _in_words(profile, f"curve {'turned about a line' if kind == 'revolution' else 'shifted'} across z")
    if kind == "extrusion":
        yield _turned(profile.vertex_mm, _keys(profile), across, np.inf, words), off
    elif (radius := middle - profile.vertex_mm) != 0.0:
        yield _turned(profile.vertex_mm, _keys(profile), along, radius, f"{words}, across it {radius:.9g} mm"), off


def _turned(vertex: float, keys: dict[str, Any], along: Array, radius_x: float, words: str) -> Form:
    """Return a toroid with its y–z section along a direction perpendicular to z; a cylinder takes the smaller rotation.

    Parameters
    ----------
    vertex : float, mm
    keys : dict
        Shape of the y–z section.
    along : (3,) float64
        Direction of y.
    radius_x : float, mm
        Radius of the x–z section.
    words : str
    """
    turn = float(np.arctan2(-along[0], along[1]))
    plain = set(keys) == {"radius_mm"}
    if plain and np.isinf(keys["radius_mm"]) != np.isinf(radius_x) and abs(np.cos(turn)) < np.sqrt(0.5):
        # A circular cylinder is the same with its sections exchanged and a rotation of 90°.
        keys, radius_x, turn = {"radius_mm": radius_x}, keys["radius_mm"], turn + 0.5 * np.pi
    turn = (turn + 0.5 * np.pi) % np.pi - 0.5 * np.pi
    if abs(turn) <= NO_TURN:
        turn = 0.0
    words = f"{words}, turned by {np.rad2deg(turn):.6g}° about z" if turn else words
    return Form(vertex, {**keys, "toroid": Toroid(radius_x_mm=radius_x)}, float(np.rad2deg(turn)), words)


def plane_through(points: Array) -> float | None:
    """Return z of the plane perpendicular to the axis that contains all points (n, 3), mm; None if there is none."""
    z = float(np.median(points[:, 2]))
    off = float(np.abs(points[:, 2] - z).max())
    return z if off <= ON_SURFACE * float(np.abs(points).max()) else None


def fitted_form(points: Array) -> tuple[Form | None, str]:
    """Return the plane or sphere about the z axis through the vertices of a mesh's face, or the reason why none fits.

    Parameters
    ----------
    points : (n, 3) float64, mm
        Vertices of the face.
    """
    size = _size(points)
    flat = plane_through(points)
    if flat is not None:
        return Form(flat, {"radius_mm": np.inf}, words="a plane by its vertices"), ""
    x, y = points[:, 0] / size, points[:, 1] / size
    terms = np.stack([x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)], axis=1)
    if len(points) < VERTICES_A_TERM * terms.shape[1]:
        return None, f"too few vertices for a sphere: {len(points)}; {VERTICES_A_TERM * terms.shape[1]} are needed"
    singular = np.linalg.svd(terms / np.linalg.norm(terms, axis=0), compute_uv=False)
    if singular[-1] < INDEPENDENT * singular[0]:
        return None, "its vertices lie at too few places for a sphere"
    # Imported only if a sphere is fitted, since it takes long.
    from scipy.spatial import cKDTree

    centre, radius = _sphere(points)
    # Signed distances along the normal.
    off = np.linalg.norm(points - [0.0, 0.0, centre], axis=1) - radius
    smooth = terms @ np.linalg.lstsq(terms, off, rcond=None)[0]
    _, near = cKDTree(points).query(points, k=NEIGHBOURS)
    form = max(float(np.abs(smooth).max()), float(np.abs(off[near].mean(axis=1)).max()))
    worst = float(np.abs(off).max())
    if not (worst <= FITTED_MM and form <= FORM_MM):
        return None, (
            f"its vertices are up to {plain(worst, 2)} mm off the nearest sphere about the z axis, {plain(form, 2)} mm "
            f"of it smooth; the limits are {FITTED_MM:g} and {FORM_MM:g} mm"
        )
    signed = _signed(radius, centre - points[:, 2].mean())
    words = f"a sphere fitted to its vertices, radius {signed:.9g} mm; they lie within {plain(worst, 2)} mm of it"
    return Form(centre - signed, {"radius_mm": signed}, words=words), ""


def _sphere(points: Array) -> tuple[float, float]:
    """Return the centre, on the z axis, and the radius of the least-squares sphere through points."""
    r2, z = np.square(points[:, :2]).sum(axis=1), points[:, 2]
    # r² + (z − m)² = R² is linear in m and R² − m²; z is taken from the middle to avoid cancellation.
    middle = float(z.mean())
    h = z - middle
    (m2, rest), *_ = np.linalg.lstsq(np.stack([h, np.ones_like(h)], axis=1), r2 + h * h, rcond=None)
    centre, radius = 0.5 * m2, float(np.sqrt(max(rest + 0.25 * m2 * m2, 0.0)))
    for _ in range(4):
        # Gauss–Newton on the distances themselves, not on their squares.
        away = np.sqrt(r2 + np.square(h - centre))
        slopes = np.stack([-(h - centre) / away, -np.ones_like(h)], axis=1)
        step = np.linalg.lstsq(slopes, radius - away, rcond=None)[0]
        centre, radius = centre + step[0], radius + step[1]
    return middle + centre, radius
