"""Sequential tracing in plain NumPy: the truth for the hard cases.

It shares no code with the engine: no mesh, no Embree, no kernels. Surfaces come in a known order. Rays meet a conic by
Welford's quadratic (Aberrations of Optical Systems, 1986, section 4.5), and other surfaces by marching and bisection.
Curved rays in gradient-index glass are those of `analytic_gradients`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.accuracy.analytic_gradients import GradientIndex, Index, index_at
from lfmesh.accuracy.analytic_phases import DiffractionOrder

Array = NDArray[np.float64]

BISECTIONS = 200

MARCH = 1024
"""Marching steps through an asphere's layer, so that the first of several crossings is found."""

LAYER = 129
"""Radii, and a quarter as many azimuths, at which the thickness of that layer is sampled."""

STEP = 1e-30
"""Imaginary step, mm, for derivatives without rounding error."""

BORDER = 1e-9
"""Width of a cell's border, over the pitch, on which either lenslet's answer is right."""


@dataclass(frozen=True)
class Interface:
    """A surface at `z` and the index behind it; `radius` may be inf. Surfaces other than conics end at `reach`."""

    radius: float
    z: float
    index: Index = 1.0
    conic: float = 0.0
    asphere: tuple[float, ...] = ()
    reach: float = 10.0
    focal_length: float = np.inf
    """Focal length of a thin lens in the surface's place, mm."""
    odd: tuple[float, ...] = ()
    across: tuple[str, float, float] | None = None
    """"biconic" or "toroid", radius and conic constant in x; `radius` and `conic` are then for y."""
    order: DiffractionOrder | None = None
    """Order of the surface's phase."""
    zone: tuple[float, "Interface"] | None = None
    """Border of an outer zone, mm, and the shape of the zone, which continues the inner one without a step."""

    @property
    def is_conic(self) -> bool:
        """True if rays meet the surface by a quadratic equation."""
        return not self.asphere and not self.odd and self.across is None and self.zone is None

    @property
    def curvature(self) -> float:
        """1/radius."""
        return 0.0 if np.isinf(self.radius) else 1.0 / self.radius

    def sag(self, r2: Array) -> Array:
        """Return the height above the vertex at r²."""
        c = self.curvature
        with np.errstate(invalid="ignore"):
            z = c * r2 / (1.0 + np.sqrt(1.0 - (1.0 + self.conic) * c * c * r2))
        z = z + sum(a * r2 ** (j + 2) for j, a in enumerate(self.asphere))
        return z + sum(b * np.sqrt(r2) ** (2 * j + 3) for j, b in enumerate(self.odd))

    def height(self, x: Array, y: Array) -> Array:
        """Return the height above the vertex at points of one shape, which may be complex."""
        if self.zone is not None:
            border, outer = self.zone
            r2, at = x * x + y * y, np.array(border * border)
            return np.where(np.real(r2) > at, outer.sag(r2) + self.sag(at) - outer.sag(at), self.sag(r2))
        if self.across is None:
            return self.sag(x * x + y * y)
        kind, radius, conic = self.across
        if kind not in ("biconic", "toroid"):
            raise NotImplementedError(f"{kind}: no height of such a surface")
        c_x, c_y = (0.0 if np.isinf(r) else 1.0 / r for r in (radius, self.radius))
        with np.errstate(invalid="ignore"):
            if kind == "toroid":
                f = self.sag(y * y)
                return f if c_x == 0.0 else 1.0 / c_x - np.sign(c_x) * np.sqrt((1.0 / c_x - f) ** 2 - x * x)
            inside = 1.0 - (1.0 + conic) * (c_x * x) ** 2 - (1.0 + self.conic) * (c_y * y) ** 2
            return np.asarray((c_x * x * x + c_y * y * y) / (1.0 + np.sqrt(inside)))

    def normal(self, p: Array) -> Array:
        """Return unit normals (n, 3), towards +z at the vertex, at points relative to the vertex."""
        c, q = self.curvature, 1.0 + self.conic
        x, y, z = p.T
        r2 = x * x + y * y
        if self.is_conic:
            n = np.stack([-c * x, -c * y, 1.0 - c * q * z], axis=1)
        elif self.odd or self.across is not None or self.zone is not None:
            by_x = np.imag(self.height(x + 1j * STEP, y + 0j)) / STEP
            by_y = np.imag(self.height(x + 0j, y + 1j * STEP)) / STEP
            n = np.stack([-by_x, -by_y, np.ones_like(x)], axis=1)
        else:
            g = c / np.sqrt(1.0 - q * c * c * r2)
            g = g + sum(2.0 * (j + 2) * a * r2 ** (j + 1) for j, a in enumerate(self.asphere))
            n = np.stack([-g * x, -g * y, np.ones_like(x)], axis=1)
        return n / np.linalg.norm(n, axis=1, keepdims=True)

    def above(self, p: Array) -> tuple[Array, Array]:
        """Return the heights of points (n, 3) above the surface, (n,), and their gradient (n, 3), camera frame."""
        at = np.column_stack([p[:, :2], self.height(p[:, 0], p[:, 1])])
        normal = self.normal(at)
        return p[:, 2] - self.z - at[:, 2], normal / normal[:, 2:]

    def meet(self, p: Array, d: Array) -> Array:
        """Return the intersections (n, 3) of rays with the vertex's sheet, relative to the vertex; NaN if none."""
        at = p - [0.0, 0.0, self.z]
        if not self.is_conic:
            return np.asarray(at + self._first_crossing(at, d)[:, None] * d)
        # Move to the vertex plane, so that the quadratic's terms stay small.
        at = at - (at[:, 2] / d[:, 2])[:, None] * d
        c, q = self.curvature, 1.0 + self.conic
        a = c * (d[:, 0] ** 2 + d[:, 1] ** 2 + q * d[:, 2] ** 2)
        b = d[:, 2] - c * (at[:, 0] * d[:, 0] + at[:, 1] * d[:, 1])
        g = c * (at[:, 0] ** 2 + at[:, 1] ** 2)
        with np.errstate(invalid="ignore", divide="ignore"):
            t = g / (b + np.sign(d[:, 2]) * np.sqrt(b * b - a * g))
        return np.asarray(at + t[:, None] * d)

    def _first_crossing(self, p: Array, d: Array) -> Array:
        """Return t of the rays' first crossing of the asphere, in the direction of travel; NaN if there is none.

        Parameters
        ----------
        p, d : (n, 3)
            Relative to the vertex.
        """
        r, phi = np.linspace(0.0, self.reach, LAYER)[:, None], np.linspace(0.0, 0.5 * np.pi, LAYER // 4)
        layer = self.height(r * np.cos(phi), r * np.sin(phi))
        slab = np.array([np.nanmin(layer) - 1e-3, np.nanmax(layer) + 1e-3])
        ahead = np.sign(d[:, 2])

        def before(t: Array) -> Array:
            """Return positive values for points that have not yet crossed; NaN outside the cylinder."""
            at = p[:, None] + t[..., None] * d[:, None]
            r2 = at[..., 0] ** 2 + at[..., 1] ** 2
            return np.where(
                r2 <= self.reach**2, ahead[:, None] * (self.height(at[..., 0], at[..., 1]) - at[..., 2]), np.nan
            )

        # The path through the slab and inside the cylinder.
        entry, leaving = np.sort((slab - p[:, 2:]) / d[:, 2:], axis=1).T
        with np.errstate(invalid="ignore", divide="ignore"):
            sideways = d[:, 0] ** 2 + d[:, 1] ** 2
            nearest = -(p[:, 0] * d[:, 0] + p[:, 1] * d[:, 1]) / sideways
            aside = (p[:, 0] * d[:, 1] - p[:, 1] * d[:, 0]) ** 2 / sideways
            half = np.sqrt((self.reach**2 - aside) / sideways)
        entry = np.fmax(np.fmax(entry, nearest - half), 0.0)
        leaving = np.fmax(np.fmin(leaving, nearest + half), entry)
        t = entry[:, None] + (leaving - entry)[:, None] * np.linspace(0.0, 1.0, MARCH + 1)
        side = before(t)
        with np.errstate(invalid="ignore"):
            passes = (side[:, :-1] > 0.0) & (side[:, 1:] <= 0.0)
        step = np.argmax(passes, axis=1)
        every = np.arange(len(p))
        near, far = t[every, step], t[every, step + 1]
        for _ in range(BISECTIONS):
            middle = 0.5 * (near + far)
            ahead_of_it = before(middle[:, None])[:, 0] > 0.0
            near, far = np.where(ahead_of_it, middle, near), np.where(ahead_of_it, far, middle)
        return np.where(passes.any(axis=1), 0.5 * (near + far), np.nan)

    def crossings(self, origins: Array, directions: Array, length: float) -> tuple[NDArray[np.int64], Array]:
        """Return the number of times rays cross the surface within its reach, and their depth between the first two.

        Parameters
        ----------
        origins : (n, 3) float64, mm
        directions : (n, 3) float64
        length : float
            Length of the rays, in units of their directions.
        """
        t = np.linspace(0.0, length, 2 * MARCH)
        at = origins[:, None] + t[:, None] * directions[:, None] - [0.0, 0.0, self.z]
        r2 = at[..., 0] ** 2 + at[..., 1] ** 2
        height = np.where(r2 <= self.reach**2, at[..., 2] - self.height(at[..., 0], at[..., 1]), np.nan)
        with np.errstate(invalid="ignore"):
            changes = height[:, :-1] * height[:, 1:] < 0.0
            first = np.cumsum(changes, axis=1) == 1
            depth = np.where(first & (height[:, 1:] > 0.0), height[:, 1:], 0.0).max(axis=1)
        return np.asarray(changes.sum(axis=1)), np.asarray(depth)


@dataclass(frozen=True)
class Bundle:
    """Rays at the end of a sequential trace: points and unit directions (n, 3), and weights (n,)."""

    p: Array
    d: Array
    weight: Array
    heights: Array
    """(n, surfaces) distance from the axis at each surface."""


def transmittance(n_i: float | Array, n_t: float | Array, cos_i: Array, cos_t: Array) -> Array:
    """Return the transmitted fraction of unpolarised light (Born and Wolf, 1.5.2).

    Parameters
    ----------
    n_i, n_t : float or (n,) float64
        Refractive indices in front and behind.
    cos_i, cos_t : (n,) float64
        Cosines of incidence and refraction.
    """
    s = 2.0 * n_i * cos_i / (n_i * cos_i + n_t * cos_t)
    p = 2.0 * n_i * cos_i / (n_t * cos_i + n_i * cos_t)
    return np.asarray(0.5 * n_t * cos_t / (n_i * cos_i) * (s * s + p * p))


def refracted(
    d: Array, normal: Array, n_i: float | Array, n_t: float | Array, change: Array | None = None
) -> tuple[Array, Array]:  # fmt: skip
    """Return the directions (n, 3) by Snell's law and the transmittances (n,); NaN for total reflection.

    Parameters
    ----------
    d : (n, 3) float64, unit
    normal : (n, 3) float64, unit, of either sense
    n_i, n_t : float or (n,) float64
        Refractive indices in front and behind.
    change : (n, 3) float64, optional
        Change of n d by a phase, before its projection on the surface. Directions are NaN for evanescent light.
    """
    cos_i = np.einsum("ij,ij->i", d, normal)
    normal = normal * np.sign(cos_i)[:, None]
    cos_i = np.abs(cos_i)
    tangential = (d - cos_i[:, None] * normal) * np.asarray(n_i / n_t)[..., None]
    with np.errstate(invalid="ignore"):
        cos_t = np.sqrt(1.0 - np.einsum("ij,ij->i", tangential, tangential))
    share = transmittance(n_i, n_t, cos_i, cos_t) if np.any(n_i != n_t) else np.ones_like(cos_i)
    if change is not None:
        along = change - np.einsum("ij,ij->i", change, normal)[:, None] * normal
        # Light that the face reflects totally has no transmitted orders.
        tangential = np.where(np.isfinite(cos_t)[:, None], tangential + along / np.asarray(n_t)[..., None], np.nan)
        with np.errstate(invalid="ignore"):
            cos_t = np.sqrt(1.0 - np.einsum("ij,ij->i", tangential, tangential))
    return tangential + cos_t[:, None] * normal, share


def through(interfaces: list[Interface], origins: ArrayLike, directions: ArrayLike, first_index: float = 1.0) -> Bundle:
    """Trace rays sequentially through surfaces, refracting at each, and turning them at phases.

    Parameters
    ----------
    interfaces : list of Interface
        In the order of the rays.
    origins : (n, 3) float64, mm
    directions : (n, 3) float64
    first_index : float
        Refractive index in front of the first one.
    """
    p = np.asarray(origins, dtype=np.float64)
    d = np.asarray(directions, dtype=np.float64)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    weight = np.ones(len(p))
    heights = []
    index: Index = first_index
    for face in interfaces:
        if isinstance(index, GradientIndex):
            met, turned, _ = index.follow(p, d, face.above)
            at, d = met - [0.0, 0.0, face.z], np.asarray(turned, np.float64)
        else:
            at = face.meet(p, d)
        p = np.add(at, [0.0, 0.0, face.z])
        n_i, n_t = (np.asarray(index_at(each, p), np.float64) for each in (index, face.index))
        change = None if face.order is None else np.asarray(face.order.change(at), np.float64)
        d, share = refracted(d, face.normal(at), n_i, n_t, change)
        if face.order is not None:
            share = share * face.order.share
        if np.isfinite(face.focal_length):
            d = _past_thin_lens(at, d, face.focal_length)
        weight = weight * share
        heights.append(np.hypot(at[:, 0], at[:, 1]))
        index = face.index
    return Bundle(p, d, weight, np.stack(heights, axis=1) if heights else np.zeros((len(p), 0)))


def _past_thin_lens(at: Array, d: Array, focal_length: float) -> Array:
    """Aim rays at, or away from, the focal point of the parallel ray through the lens's centre."""
    aimed = np.sign(focal_length) * (focal_length * d / d[:, 2:] - at)
    return np.asarray(aimed / np.linalg.norm(aimed, axis=1, keepdims=True))


def at_plane(p: Array, d: Array, z: float) -> Array:
    """Return (n, 3) where rays meet a plane z; NaN where they run away from it.

    Parameters
    ----------
    p : (n, 3) float64, mm
    d : (n, 3) float64
    z : float, mm
    """
    with np.errstate(divide="ignore"):
        t = (z - p[:, 2]) / d[:, 2]
    return np.asarray(p + np.where(t >= 0.0, t, np.nan)[:, None] * d)


@dataclass(frozen=True)
class Plate:
    """A lenslet array in its own frame (z from the curved face into the glass), and a sensor behind it."""

    hexagonal: bool
    pitch: float
    columns: int
    rows: int
    radius: float
    thickness: float
    index: float
    to_sensor: float
    conic: float = 0.0
    asphere: tuple[float, ...] = ()
    back_radius: float = np.inf
    """mm, positive for convex lenslets on the other face."""
    order: DiffractionOrder | None = None
    """Order of the phase about each lenslet's centre."""

    def centres(self, column: NDArray[np.int64], row: NDArray[np.int64]) -> Array:
        """Return the centres (..., 2) of cells."""
        x = column - 0.5 * (self.columns - 1)
        y = row - 0.5 * (self.rows - 1)
        if self.hexagonal:
            x = x + 0.5 * (row % 2) - (0.25 if self.rows > 1 else 0.0)
            y = y * np.sqrt(0.75)
        return np.stack([x, y], axis=-1) * self.pitch

    def _cells_near(self, p: Array, around: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        row = np.rint(p[:, 1] / (self.pitch * (np.sqrt(0.75) if self.hexagonal else 1.0)) + 0.5 * (self.rows - 1))
        column = np.rint(p[:, 0] / self.pitch + 0.5 * (self.columns - 1))
        j, i = np.meshgrid(np.arange(-around, around + 1), np.arange(-around, around + 1), indexing="ij")
        return (
            (column[:, None] + i.ravel()).astype(np.int64),
            (row[:, None] + j.ravel()).astype(np.int64),
        )

    def land(self, origins: Array, directions: Array, around: int = 3) -> tuple[Array, Array]:
        """Return the possible landing points on the sensor of rays from in front of the array, and their weights.

        Each lenslet near the crossing is tried separately: its face counts inside its own Voronoi cell, and the first
        of several faces counts. On a border, to rounding, two or three answers are right.

        Parameters
        ----------
        origins : (n, 3) float64, mm
        directions : (n, 3) float64
        around : int
            Cells to try on each side of the nearest one.

        Returns
        -------
        points : (k, n, 3)
            NaN where there are fewer than k.
        weights : (k, n)
        """
        d = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        start = at_plane(origins, d, 0.0)
        column, row = self._cells_near(start, around)
        centre = self.centres(column, row)
        corner = self.pitch / np.sqrt(3.0 if self.hexagonal else 2.0)
        face = Interface(self.radius, 0.0, conic=self.conic, asphere=self.asphere, reach=1.001 * corner)
        met, entered, normals, changes = [], [], [], []
        for k in range(centre.shape[1]):
            exists = (column[:, k] >= 0) & (column[:, k] < self.columns) & (row[:, k] >= 0) & (row[:, k] < self.rows)
            shift = np.column_stack([centre[:, k], np.zeros(len(d))])
            at = face.meet(start - shift, d)
            t = np.einsum("ij,ij->i", at + shift - start, d)
            met.append(np.where(exists & (self._depth_in_cell(at[:, :2]) >= -BORDER), t, np.inf))
            entered.append(at + shift)
            normals.append(face.normal(at))
            changes.append(np.zeros(d.shape) if self.order is None else self.order.change(at))
        order = np.argsort(met, axis=0)[:3]
        best = np.min(met, axis=0)
        every = np.arange(len(d))
        landings, weights = [], []
        for k in order:
            right = np.array(met)[k, every] <= best + BORDER * self.pitch
            point, normal = np.array(entered)[k, every], np.array(normals)[k, every]
            change = None if self.order is None else np.array(changes)[k, every]
            inside, share = refracted(d, normal, 1.0, self.index, change)
            exit_point, facing = self._at_other_face(point, inside)
            out, leaving = refracted(inside, facing, self.index, 1.0)
            landing = at_plane(exit_point, out, self.thickness + self.to_sensor)
            landings.append(np.where((right & np.isfinite(best))[:, None], landing, np.nan))
            weights.append(share * leaving * (1.0 if self.order is None else self.order.share))
        return np.array(landings), np.array(weights)

    def _at_other_face(self, p: Array, d: Array) -> tuple[Array, Array]:
        """Return the intersections of rays in the glass with the other face, and its normals; NaN if they miss."""
        flat = at_plane(p, d, self.thickness)
        if not np.isfinite(self.back_radius):
            return flat, np.broadcast_to([0.0, 0.0, 1.0], d.shape)
        column, row = self._cells_near(np.nan_to_num(flat), 1)
        centre = self.centres(column, row)
        corner = self.pitch / np.sqrt(3.0 if self.hexagonal else 2.0)
        face = Interface(-self.back_radius, 0.0, reach=1.001 * corner)
        at, normals, nearest = np.full(d.shape, np.nan), np.full(d.shape, np.nan), np.full(len(d), np.inf)
        for k in range(centre.shape[1]):
            shift = np.column_stack([centre[:, k], np.full(len(d), self.thickness)])
            hit = face.meet(p - shift, d)
            t = np.einsum("ij,ij->i", hit + shift - p, d)
            first = (self._depth_in_cell(hit[:, :2]) >= -BORDER) & (t < nearest)
            at[first], normals[first], nearest[first] = (hit + shift)[first], face.normal(hit)[first], t[first]
        return at, normals

    def _depth_in_cell(self, p: Array) -> Array:
        """Return the depth of points inside the cell at the origin, over the pitch; negative outside."""
        turn = np.deg2rad([0.0, 60.0, 120.0]) if self.hexagonal else np.deg2rad([0.0, 90.0])
        across = np.abs(p @ np.stack([np.cos(turn), np.sin(turn)])).max(axis=1)
        return np.asarray(0.5 - across / self.pitch)
