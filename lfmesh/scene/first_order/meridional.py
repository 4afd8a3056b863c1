"""Real meridional rays of a lens, for the true width of its axial beam.

Plain floats, as a scene is judged before anything is built; interval bounds add proof.
"""

import math
from collections.abc import Sequence
from itertools import zip_longest

import numpy as np

from lfmesh.optics.bounds import ROUNDING, Array, Range, first_below
from lfmesh.optics.glass import refractive_index
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.camera.surface import Surface
from lfmesh.scene.first_order.beam_bounds import Beam, followed, widest_mm
from lfmesh.scene.first_order.gradient_rays import GradientSpace, space_behind
from lfmesh.scene.first_order.phase_turns import turn_in_meridian

STEPS = 50
"""Maximum number of Newton steps to a surface."""

TRIALS = 60
"""Maximum number of rays in the search for the one at the edge of the stop."""

SAMPLES = 128
"""Number of rays of a beam through gradient-index glass, for which there are no bounds."""


def heights_mm(lens: Lens, wavelength_nm: float, object_mm: float, height_mm: float) -> list[float]:
    """Return the heights at the surfaces, in order, of a real ray from the axial object point.

    Parameters
    ----------
    lens : Lens
        Solved, with surfaces of revolution only.
    wavelength_nm : float
    object_mm : float
        Distance before the first vertex; inf for light parallel to the axis, negative for a converging ray.
    height_mm : float
        Height in the plane of the first vertex.

    Returns
    -------
    list of float
        One height per surface reached: the ray ends at a miss or total reflection.
    """
    return _followed(lens, wavelength_nm, object_mm, height_mm)[0]


def _followed(lens: Lens, wavelength_nm: float, object_mm: float, height_mm: float) -> tuple[list[float], int | None]:
    """Return the `heights_mm` of a ray, and the number of the surface at which it ends; None if it passes all."""
    z, y = 0.0, height_mm
    angle = 0.0 if math.isinf(object_mm) else math.atan2(height_mm, object_mm)
    if object_mm < 0:
        angle = math.atan2(-height_mm, -object_mm)
    heights: list[float] = []
    index, *behind = (refractive_index(medium, wavelength_nm) for medium in lens.media)
    space: GradientSpace | None = None
    for number, (surface, vertex, after) in enumerate(zip(lens.surfaces, lens.vertices_mm, behind, strict=True)):
        if space is not None:
            y, z, angle, index = _through(space, surface, (y, z, angle), vertex)
        met = _meet(surface, y, z - vertex, math.tan(angle))
        if met is None:
            return heights, number
        y, sag = met
        z = vertex + sag
        heights.append(y)
        space = space_behind(surface, wavelength_nm)
        if surface.paraxial:
            angle = math.atan(math.tan(angle) - y * surface.thin_lens_power_per_mm)
            continue
        if space is not None:
            after = float(space.index_at(np.array([[0.0, y, sag]]))[0])
        # The normal is inclined towards the axis by the arctangent of the sag's slope.
        normal = -math.atan(_slope(surface, y))
        sine = index / after * math.sin(angle - normal)
        if surface.phase is not None:
            sine += turn_in_meridian(surface.phase, wavelength_nm, y) / after * math.cos(normal)
        if not abs(sine) <= 1.0:
            return heights, number
        angle = normal + math.asin(sine)
        index = after
    return heights, None


def _through(
    space: GradientSpace, surface: Surface, ray: tuple[float, float, float], vertex: float
) -> tuple[float, float, float, float]:
    """Return the straight ray that ends on a surface as one through gradient-index glass does.

    Parameters
    ----------
    space : GradientSpace
        Glass before the surface.
    surface : Surface
    ray : tuple of float
        y and z in the camera frame, in mm, and angle, on the face in front of the glass.
    vertex : float
        z of the surface's vertex, in mm.

    Returns
    -------
    tuple of float
        y, z and angle at the end, and the index there; NaN if the ray does not reach the surface.
    """

    def met(points: Array, directions: Array) -> Array:
        (_, y, z), (_, by_y, by_z) = points[0], directions[0]
        found = _meet(surface, y, z - space.length_mm, by_y / by_z) if by_z > 0.0 else None
        return np.full((1, 3), np.nan) if found is None else np.array([[0.0, found[0], found[1] + space.length_mm]])

    y, z, angle = ray
    front = vertex - space.length_mm
    start, along = np.array([[0.0, y, z - front]]), np.array([[0.0, math.sin(angle), math.cos(angle)]])
    point, direction = space.followed(start, along, met)
    index = float(space.index_at(point)[0])
    return float(point[0, 1]), front + float(point[0, 2]), math.atan2(direction[0, 1], direction[0, 2]), index


def beam_mm(
    lens: Lens, wavelength_nm: float, object_mm: float, guess_mm: float, clear_mm: Sequence[float] | float = 0.0
) -> Beam:
    """Return the largest height at each surface of the beam that fills the stop, ignoring other apertures.

    The beam ends with the first ray from the axis that meets the edge of the stop. Spherical aberration can carry inner
    rays farther out than edge rays. Through gradient-index glass, nothing is proven beyond the traced rays.

    Parameters
    ----------
    lens, wavelength_nm, object_mm, guess_mm
        As in `edge_of_stop_mm`.
    clear_mm
        As in `beam_bounds.widest_mm`.

    Returns
    -------
    Beam
        Without heights if no ray reaches the edge of the stop.
    """
    entry, edge = edge_of_stop_mm(lens, wavelength_nm, object_mm, guess_mm)
    if lens.has_gradients:
        return _sampled_beam(lens, wavelength_nm, object_mm, entry)
    if edge:
        beam, all_pass = widest_mm(lens, wavelength_nm, object_mm, entry, clear_mm)
        if all_pass:
            return beam
    # Some rays inside this one miss the stop: the beam ends at the first of them.
    entry = _end_of_beam_mm(lens, wavelength_nm, object_mm, entry)
    heights = heights_mm(lens, wavelength_nm, object_mm, entry)
    if not _meets_edge(lens, heights):
        return Beam([], [])
    return widest_mm(lens, wavelength_nm, object_mm, entry, clear_mm)[0]


def _sampled_beam(lens: Lens, wavelength_nm: float, object_mm: float, most_mm: float) -> Beam:
    """Return the largest height at each surface of traced rays up to the first one outside the stop's edge.

    Parameters
    ----------
    lens, wavelength_nm, object_mm
        As in `heights_mm`.
    most_mm : float
        Height of the outermost ray in the plane of the first vertex.
    """
    stop = lens.stop_index or 0
    limit = (lens.surfaces[stop].semi_diameter_mm or math.nan) * (1 + 1e-6)
    highest, meets_edge = [0.0] * len(lens.surfaces), False
    for k in range(1, SAMPLES + 1):
        heights, end = _followed(lens, wavelength_nm, object_mm, most_mm * k / SAMPLES)
        if len(heights) <= stop:
            break
        if abs(heights[stop]) > limit:
            meets_edge = True
            break
        highest = [max(one, abs(other)) for one, other in zip_longest(highest, heights, fillvalue=0.0)]
        if end is not None:
            highest[end] = math.inf
        meets_edge = meets_edge or _meets_edge(lens, heights)
    return Beam(highest, highest) if meets_edge else Beam([], [])


def _end_of_beam_mm(lens: Lens, wavelength_nm: float, object_mm: float, most_mm: float) -> float:
    """Return the height of the first ray outside the stop's edge or ending before the stop, or `most_mm` if none.

    Parameters
    ----------
    lens, wavelength_nm, object_mm
        As in `heights_mm`.
    most_mm : float
        Upper end of the search.
    """
    stop = lens.stop_index or 0

    def ranges_of(low: Array, high: Array) -> list[Range]:
        """Return bounds of minus the absolute height in the stop, and of its derivative."""
        zones = followed(lens, wavelength_nm, object_mm, low[:, 0], high[:, 0])
        (least, most), rate = zones.heights_mm[stop], np.abs(zones.slopes[stop]).max(axis=0)
        near = np.where((least < 0.0) & (most > 0.0), 0.0, np.minimum(np.abs(least), np.abs(most)))
        return [(-np.maximum(np.abs(least), np.abs(most)), -near), (-rate, rate)]

    radius = lens.surfaces[stop].semi_diameter_mm or math.nan
    with np.errstate(invalid="ignore"):
        return first_below(ranges_of, [0.0], [most_mm], -radius, ROUNDING)


def _meets_edge(lens: Lens, heights: Sequence[float]) -> bool:
    """Tell whether a ray with these heights at the surfaces meets the edge of the stop, within rounding."""
    stop = lens.stop_index or 0
    return len(heights) > stop and abs(heights[stop]) >= (lens.surfaces[stop].semi_diameter_mm or math.nan) * (1 - 1e-6)


def edge_of_stop_mm(
    lens: Lens, wavelength_nm: float, object_mm: float, guess_mm: float
) -> tuple[float, list[float]]:  # fmt: skip
    """Return a real axial ray that meets the edge of the stop, ignoring other apertures; any one of several.

    Parameters
    ----------
    lens : Lens
    wavelength_nm, object_mm : float
        As in `heights_mm`.
    guess_mm : float
        Paraxial height in the plane of the first vertex.

    Returns
    -------
    entry : float
        Height in the plane of the first vertex.
    heights : list of float
        Heights at the surfaces; empty if the glass ends before any ray reaches the edge.
    """
    stop = lens.stop_index or 0
    radius = lens.surfaces[stop].semi_diameter_mm or math.nan

    def at(height: float) -> tuple[float, list[float]]:
        """Return a ray's excess over the stop's edge, inf if it ends before the stop, and its heights."""
        heights = heights_mm(lens, wavelength_nm, object_mm, height)
        return abs(heights[stop]) - radius if len(heights) > stop else math.inf, heights

    low, high = 0.0, abs(guess_mm)
    (below, inside), (above, outside) = at(low), at(high)
    for _ in range(8):
        if above >= 0:
            break
        low, below, inside, high = high, above, outside, 1.5 * high
        above, outside = at(high)
    for trial in range(TRIALS):
        # Regula falsi if both ends reach the stop; otherwise, and every third time, bisection.
        share = 0.5 if trial % 3 == 2 or math.isinf(above) else below / (below - above)
        height = low + share * (high - low)
        if not low < height < high:
            break
        excess, heights = at(height)
        if excess >= 0:
            high, above, outside = height, excess, heights
        else:
            low, below, inside = height, excess, heights
    height, heights = (high, outside) if above < -below else (low, inside)
    return height, heights if _meets_edge(lens, heights) else []


def _meet(surface: Surface, y: float, z: float, slope: float) -> tuple[float, float] | None:
    """Return height and sag of a ray's intersection with a surface, given from its vertex, or None on a miss."""
    height = y - z * slope
    for _ in range(STEPS):
        if abs(height) > surface.reach_mm:
            return None
        excess = height - (y + (surface.sag_mm(height) - z) * slope)
        if abs(excess) < 1e-13 * (1 + abs(height)):
            return height, surface.sag_mm(height)
        fall = 1 - _slope(surface, height) * slope
        if fall == 0:
            return None
        height -= excess / fall
    return None


def _slope(surface: Surface, height: float) -> float:
    """Return the derivative of the sag."""
    if surface.outer_zone is not None:
        return surface.outer_zone.zone_at(surface, height).slope(height)
    c = surface.curvature_per_mm
    root = math.sqrt(max(1e-300, 1 - (1 + surface.vertex_conic) * c * c * height * height))
    terms = (power * a * abs(height) ** (power - 1) for power, a in surface.powers_mm)
    return c * height / root + math.copysign(1.0, height) * sum(terms)
