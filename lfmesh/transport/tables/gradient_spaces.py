"""Spaces of the lens that gradient-index glass fills, as kernels read them: profiles, steps, frames and edges.

The number of steps of a space comes from probe rays, once for each wavelength, so that all rays of a block take equally
many. The same gradient behind two surfaces is one medium, but has a frame, and a number of steps, of its own in either
space.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import GlassError, SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.lens.gradient_gap import BACK, FRONT, Gap, follow_rays_in_gap
from lfmesh.geometry.lens.lens_shape import LensShape
from lfmesh.geometry.surfaces.bends import rim_range
from lfmesh.geometry.surfaces.tessellation import mesh_heights
from lfmesh.kernels.by_address import by_address
from lfmesh.optics.gradient_paraxial import gap_matrix, index_on_axis
from lfmesh.optics.gradient_path import PROBE_PRECISION, arriving_probes, least_steps, starting_rays, steps_needed
from lfmesh.optics.gradient_shapes import GradientProfile
from lfmesh.optics.gradients import Gradients, fields_at, gradient_table
from lfmesh.scene import Scene
from lfmesh.scene.camera.gradient import Gradient

Array = NDArray[np.float64]

PROBE_HEIGHTS = (0.0, 0.5, 0.95)
"""Heights of probe rays on the face that they start from, and of the points on the other face that they are aimed at,
over the radius of the rim."""

STEEPER = (1.0, 2.0, 4.0)
"""Factors on the slopes of probe rays. Gradients bend rays that start steeper than the rims allow, so that they arrive
all the same; other rays end on the edge, and count no more."""

WIDER = 1.25
"""Factor on the rims of the gap where probe rays that arrive are compared."""

Frames = NDArray[np.float64]


@by_address
class GradientSpaces(NamedTuple):
    """Spaces of the lens with gradient-index glass; the own frame of a space is that of its `Gap`."""

    # (K + 1,) row of each space's profile at the first wavelength, the others follow; −1: homogeneous
    number: NDArray[np.int64]
    steps: NDArray[np.int64]  # (K + 1, wavelengths) equal steps from face to face
    longest: Array  # (K + 1, wavelengths) mm in σ, longest step; rays that need longer ones take more
    gradients: Gradients
    pose: Frames  # (K + 1, 3, 4) from the own frame to the camera frame
    unpose: Frames  # (K + 1, 3, 4) the inverse
    origin_z: Array  # (K + 1,) mm, z of the own frame's origin among the surfaces without poses
    edge: Array  # (K + 1, 4) mm, z and radius of the front rim, then of the back rim, own frame
    # (K + 1, wavelengths, 5) matrix (a, b, c, d) of each gap on heights and reduced angles in the y–z section, and the
    # index on the axis at its rear vertex
    paraxial: Array
    revolved: bool  # whether all of them are symmetrical about the axes of their faces


def has_gradients(scene: Scene) -> bool:
    """Tell whether gradient-index glass stands in the lens or the array of a scene."""
    return any(True for _ in scene.gradients())


def stop_within_gradients(scene: Scene) -> bool:
    """Tell whether gradient-index glass stands on both sides of the stop of a scene's lens."""
    surfaces, stop = scene.camera.lens.surfaces, scene.camera.lens.stop_index
    if not stop:
        return False
    return surfaces[stop].gradient is not None and surfaces[stop - 1].gradient is not None


def gradient_spaces(scene: Scene, shape: LensShape, wavelengths_nm: tuple[float, ...]) -> GradientSpaces | None:
    """Return the spaces of a lens with gradient-index glass; None if it has none.

    Parameters
    ----------
    scene : Scene
    shape : LensShape
    wavelengths_nm : (wavelengths,) tuple of float

    Raises
    ------
    SceneError
        An index is not real in all of the glass, or changes too fast.
    """
    media = {space: medium for space, medium in enumerate(shape.media) if isinstance(medium, Gradient)}
    if not media:
        return None
    count, colours = len(shape.media), len(wavelengths_nm)
    number, steps = np.full(count, -1, np.int64), np.zeros((count, colours), np.int64)
    longest, origin_z, edge = np.zeros((count, colours)), np.zeros(count), np.zeros((count, 4))
    pose, paraxial = np.tile(frame.IDENTITY, (count, 1, 1)), np.zeros((count, colours, 5))
    profiles: list[GradientProfile] = []
    for space, medium in media.items():
        front, back = shape.surfaces[space - 1 : space + 1]
        rims, origin = shape.rims[space - 1 : space + 1], float(front["vertex_z"])
        number[space], origin_z[space] = len(profiles), origin
        pose[space] = frame.compose(front["pose"], frame.frame(origin_mm=(0.0, 0.0, origin)))
        for side, (face, rim) in enumerate(zip((front, back), rims, strict=True)):
            edge[space, 2 * side : 2 * side + 2] = (
                float(face["vertex_z"]) - origin + float(np.mean(rim_range(face, rim))), rim,
            )  # fmt: skip
        gap, length = Gap(shape.surfaces, space, origin, *map(float, rims)), float(back["vertex_z"]) - origin
        try:
            own = [medium.profile(wavelength_nm) for wavelength_nm in wavelengths_nm]
            found: dict[bytes, tuple[int, float]] = {}
            for colour, profile in enumerate(own):
                key = profile.numbers.tobytes() + profile.material.tobytes()
                if key not in found:
                    found[key] = _steps_of(profile, gap, around=not medium.of_revolution)
                steps[space, colour], longest[space, colour] = found[key]
                paraxial[space, colour] = *gap_matrix(profile, length), index_on_axis(profile, length)
        except GlassError as error:
            raise SceneError(f"camera.lens.surfaces[{shape.numbers[space - 1]}].gradient: {error}") from error
        profiles += own
    return GradientSpaces(
        number=number,
        steps=steps,
        longest=longest,
        gradients=gradient_table(profiles),
        pose=pose,
        unpose=np.array([frame.inverse(each) for each in pose]),
        origin_z=origin_z,
        edge=edge,
        paraxial=paraxial,
        revolved=all(medium.of_revolution for medium in media.values()),
    )


def _steps_of(profile: GradientProfile, gap: Gap, *, around: bool) -> tuple[int, float]:
    """Return the number of steps of a gap, and the longest step in σ, mm, from probe rays in both directions.

    Parameters
    ----------
    profile : GradientProfile
    gap : Gap
    around : bool
        Start probes in all directions from the axis; else in one.
    """
    gradients = gradient_table([profile])
    points, directions, lengths = _probes(gap, around)
    squares = fields_at(gradients, 0, points)[:, 0]
    if not (squares > 0.0).all():
        x, y, z = points[int(np.argmin(np.where(np.isfinite(squares), squares, -np.inf)))]
        raise GlassError(
            f"n² = {squares.min():.6g} at {np.hypot(x, y):.4g} mm from the axis, {z:.4g} mm behind the vertex; the "
            "index must be real in all of the glass"
        )
    rays, span = starting_rays(gradients, 0, points, directions), float((lengths / np.sqrt(squares)).max())

    def traced(some: Array, within: Gap, steps: int) -> tuple[NDArray[np.bool_], Array]:
        ends, walls = some.copy(), np.zeros(len(some), np.int64)
        follow_rays_in_gap(gradients, 0, within, ends, walls, span / steps, steps)
        return (walls == FRONT) | (walls == BACK), ends

    least = least_steps(gradients, 0, points, span, 2.0 * max(gap.front_rim, gap.back_rim))
    arriving = rays[arriving_probes(lambda count: traced(rays, gap, count)[0], least)]
    if not len(arriving):
        raise GlassError("no ray from one face reaches the other one")
    # Rays that just pass the edge would pass it in some numbers of steps only.
    wide = gap._replace(front_rim=WIDER * gap.front_rim, back_rim=WIDER * gap.back_rim)
    needed = steps_needed(lambda count: traced(arriving, wide, count), PROBE_PRECISION * float(lengths.max()))
    steps = max(needed, least)
    return steps, span / steps


def _probes(gap: Gap, around: bool) -> tuple[Array, Array, Array]:
    """Return starts (n, 3), mm, and unit directions of probe rays, and their lengths (n,), mm, on straight lines."""
    turns = np.arange(4 if around else 1) * (0.5 * np.pi)
    faces = [
        (surface, rim, float(surface["vertex_z"]) - gap.origin_z)
        for surface, rim in zip(
            gap.surfaces[gap.space - 1 : gap.space + 1], (gap.front_rim, gap.back_rim), strict=True
        )
    ]  # fmt: skip

    def on_face(side: int, height: float, turn: float) -> Array:
        surface, rim, vertex_z = faces[side]
        x, y = height * rim * np.sin(turn), height * rim * np.cos(turn)
        return np.array([x, y, vertex_z + float(mesh_heights(surface, x, y))])

    points, ways, lengths = [], [], []
    for side in (FRONT, BACK):
        for turn, height in ((turn, height) for turn in turns for height in PROBE_HEIGHTS):
            start = on_face(side, height, turn)
            for aside, other in ((aside, other) for aside in (0.0, 0.5, 1.0) for other in PROBE_HEIGHTS):
                way = on_face(1 - side, other, turn + aside * np.pi) - start
                for factor in STEEPER:
                    points.append(start)
                    ways.append(way * [factor, factor, 1.0])
                    lengths.append(float(np.linalg.norm(way)))
    along = np.array(ways)
    return np.array(points), along / np.linalg.norm(along, axis=1, keepdims=True), np.array(lengths)


def fills_space(gradients: GradientSpaces | None, space: int) -> bool:
    """Tell whether gradient-index glass fills a space of the lens; for kernels see `events.gradient.in_gradient`."""
    return gradients is not None and bool(gradients.number[space] >= 0)


def of_spaces(gradients: GradientSpaces | None, first: int, last: int) -> GradientSpaces | None:
    """Return the table of the spaces around consecutive faces of a lens.

    Parameters
    ----------
    gradients : GradientSpaces or None
    first, last : int
        First face, and end of the faces (excluded).
    """
    if gradients is None:
        return None
    names = ("number", "steps", "longest", "pose", "unpose", "origin_z", "edge", "paraxial")
    return gradients._replace(**{name: getattr(gradients, name)[first : last + 1] for name in names})


def without_edges(gradients: GradientSpaces | None) -> GradientSpaces | None:
    """Return the table of gradient-index glass without end sideways."""
    if gradients is None:
        return None
    edge = gradients.edge.copy()
    edge[:, 1::2] = np.inf
    return gradients._replace(edge=edge)


def unposed(gradients: GradientSpaces | None) -> GradientSpaces | None:
    """Return the table of gradient-index glass in its prescribed place."""
    if gradients is None:
        return None
    pose = np.array([frame.frame(origin_mm=(0.0, 0.0, z)) for z in gradients.origin_z])
    return gradients._replace(pose=pose, unpose=np.array([frame.inverse(each) for each in pose]))


def is_revolved_by_gradients(gradients: GradientSpaces | None) -> bool:
    """Tell whether the gradients of a lens, if any, are symmetrical about the axes of their faces."""
    return gradients is None or gradients.revolved
