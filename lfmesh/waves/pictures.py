"""Pictures of many points by their point spreads: the columns of wave matrices.

Where a camera repeats itself from lenslet to lenslet, as a light-field microscope with pupils at infinity does, points
that lie the image of a pitch apart have the same picture, a pitch aside; where nothing is off its axis, points that
mirror each other have mirrored pictures. One of them is then computed, and one more in each plane, which says by how
much the rest are off.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene import Scene, first_order
from lfmesh.scene.camera.mla import ArrayForm, MicrolensArray
from lfmesh.scene.pose import Pose
from lfmesh.waves.point_spread import TOLERANCE, Asked, followed
from lfmesh.waves.wave_camera import WaveCamera

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

SAME = 1e-6
"""Distance of places that count as one, over the step from point to point that repeats; of planes, over their own."""

WHOLE_PX = 1e-6
"""Largest difference of the pitch of micro-images from a whole number of pixels."""


class Repeats(NamedTuple):
    """Step between points that have the same picture, a pitch aside.

    Attributes
    ----------
    object_mm : float
        From point to point.
    pixels : int
        From picture to picture; below 0 where the lens inverts.
    mirrors : bool
        Pictures of points that mirror each other about x, y or the diagonal are mirrored.
    """

    object_mm: float
    pixels: int
    mirrors: bool


class Pictures(NamedTuple):
    """Pictures of points of 1 W/sr.

    Attributes
    ----------
    mean : (points, rows, columns) float64, W
    error : float
        Largest sum of differences over a picture's power, found by finer grids and where pictures were repeated.
    beyond : float
        Largest share of the light of one that went beyond its grid, see `PointSpread`.
    computed : int
        Point spreads that were computed.
    """

    mean: Array
    error: float
    beyond: float
    computed: int


def pictures_of_points(
    scene: Scene, points_mm: Array, wavelength_nm: float, *, tolerance: float = TOLERANCE
) -> Pictures:  # fmt: skip
    """Return the pictures of points by `lf.point_spread`, with as few spreads as the camera allows.

    Parameters
    ----------
    scene : Scene
    points_mm : (n, 3) float64
        Camera frame.
    wavelength_nm : float
    tolerance : float
        As of `point_spread`; pictures that repeat and differ by more are computed one by one.

    Raises
    ------
    LfmeshError
        As from `point_spread`.
    """
    columns, rows = scene.camera.sensor.pixels
    mean, worst, beyond, computed = np.zeros((len(points_mm), rows, columns)), 0.0, 0.0, 0
    repeats, camera = repeats_of(scene), WaveCamera.of(scene)

    def spread(of: WaveCamera, point: Array) -> Array:
        nonlocal worst, beyond, computed
        found = followed(of, point, wavelength_nm, asked=Asked(tolerance=tolerance))
        worst, beyond, computed = max(worst, found.change), max(beyond, found.beyond), computed + 1
        return found.mean

    for plane in _planes(points_mm):
        shared = repeats and _repeated(camera, points_mm[plane], repeats, spread)
        if shared and shared.off <= tolerance:
            mean[plane], worst = shared.mean, max(worst, shared.off)
        else:
            for number in plane:
                mean[number] = spread(camera, points_mm[number])
    return Pictures(mean, worst, beyond, computed)


def repeats_of(scene: Scene) -> Repeats | None:
    """Return the step after which a camera repeats itself; None where it does not, or pixels do not fit lenslets.

    Parameters
    ----------
    scene : Scene
    """
    mla, facts = scene.camera.mla, first_order(scene)
    alike = mla is not None and mla.layout == "square" and mla.types == 1 and mla.form == ArrayForm()
    if mla is None or not alike or facts.micro_image_pitch_px is None:
        return None
    pixels = round(facts.micro_image_pitch_px)
    telecentric = np.isinf(facts.entrance_pupil_z_mm) and np.isinf(facts.exit_pupil_z_mm)
    if not telecentric or pixels == 0 or abs(facts.micro_image_pitch_px - pixels) > WHOLE_PX:
        return None
    step_mm = mla.pitch_mm / abs(facts.magnification)
    return Repeats(step_mm, int(np.copysign(pixels, facts.magnification)), _is_symmetric(scene, mla))


def _is_symmetric(scene: Scene, mla: MicrolensArray) -> bool:
    """Return True of a camera that a mirror along x, y or the diagonal leaves as it is."""
    lens, sensor = scene.camera.lens, scene.camera.sensor
    centred = mla.pose == sensor.pose == Pose() and not lens.elements
    square = len({*mla.count}) == 1 and len({*sensor.pixels}) == 1 and mla.cylinder_axis is None
    return centred and square and lens.number_off_revolution is None


class _Shared(NamedTuple):
    """Pictures of the points of a plane from those about the axis, and the difference of one from its own."""

    mean: Array
    off: float


def _repeated(
    camera: WaveCamera, points: Array, repeats: Repeats, spread: Callable[[WaveCamera, Array], Array]
) -> _Shared | None:
    """Return the pictures of points of a plane by shifting those of points about the axis; None of too few points.

    Parameters
    ----------
    camera : WaveCamera
    points : (n, 3) float64, mm
        At one distance.
    repeats : Repeats
    spread : callable
        Computes the picture of a point.
    """
    steps = np.round(points[:, :2] / repeats.object_mm - SAME).astype(np.int64)
    near = points[:, :2] - repeats.object_mm * steps
    mirrored = (near < 0.0) & repeats.mirrors
    near = np.where(mirrored, -near, near)
    turned = (near[:, 1] > near[:, 0]) & repeats.mirrors
    near[turned] = near[turned, ::-1]
    key = np.round(near / (SAME * repeats.object_mm))
    _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
    group = group.ravel()
    if len(first) + 1 >= len(points):
        return None
    # Wide enough that every picture lies within that of the point about the axis.
    margin = int(np.abs(steps).max()) * abs(repeats.pixels)
    columns, rows = camera.scene.camera.sensor.pixels
    wide = WaveCamera.of(camera.scene.changed({"camera.sensor.pixels": (columns + 2 * margin, rows + 2 * margin)}))
    mean = np.zeros((len(points), rows, columns))
    for number, member in enumerate(first):
        whole = spread(wide, np.array([*near[member], points[member, 2]]))
        for point in np.flatnonzero(group == number):
            left, low = margin - repeats.pixels * steps[point]
            seen = whole.T if turned[point] else whole
            across, along = (slice(None, None, -1 if flips else 1) for flips in mirrored[point])
            mean[point] = seen[along, across][low : low + rows, left : left + columns]
    # The array's rim, and what else does not repeat, is felt most where the shift is largest.
    farthest = int((3 * np.abs(steps).max(axis=1) + mirrored.sum(axis=1) + turned).argmax())
    own = spread(camera, points[farthest])
    return _Shared(mean, float(np.abs(mean[farthest] - own).sum() / own.sum()))


def _planes(points: Array) -> Iterator[Numbers]:
    """Yield the numbers of the points at each distance."""
    depth = np.round(points[:, 2] / (SAME * np.abs(points[:, 2]).max()))
    for z in np.unique(depth):
        yield np.flatnonzero(depth == z)
