"""Point spreads of many points, the columns of wave matrices.

A light-field microscope with pupils at infinity repeats itself from lenslet to lenslet: points separated by the image
of a pitch have the same picture, shifted by a pitch. If nothing is off axis, mirrored points have mirrored pictures.
One spread then serves all of them; one more in each plane gives the error.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.lens.main_order import phases_of
from lfmesh.scene import Scene, first_order
from lfmesh.scene.camera.lenslet_optics import sections
from lfmesh.scene.camera.mla import ArrayForm, MicrolensArray
from lfmesh.scene.pose import Pose
from lfmesh.waves.point_spread import TOLERANCE, Asked, followed
from lfmesh.waves.wave_camera import WaveCamera

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

SAME = 1e-6
"""Largest distance of points that count as one, over the repeating step; of planes, over their distance."""

WHOLE_PX = 1e-6
"""Largest difference of the micro-image pitch from a whole number of pixels."""


class Repeats(NamedTuple):
    """Step between points that have the same picture, shifted by a pitch.

    Attributes
    ----------
    object_mm : float
        Step between the points.
    pixels : int
        Step between the pictures; negative if the lens inverts.
    mirrors : bool
        True if points mirrored about x, y or the diagonal have mirrored pictures.
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
        Largest sum of differences over a picture's power, by finer grids and repeats.
    beyond : float
        Largest fraction of a picture's light beyond its grid, see `PointSpread`.
    computed : int
        Number of point spreads computed.
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
        As for `point_spread`. Above it, repeated pictures are computed one by one.

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
    """Return the step after which a camera repeats itself, or None if it does not or pixels do not fit lenslets.

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
    """Tell whether a mirror along x, y or the diagonal leaves a camera unchanged."""
    lens, sensor = scene.camera.lens, scene.camera.sensor
    centred = mla.pose == sensor.pose == Pose() and not lens.elements
    revolved = all(phase.of_revolution for phase in phases_of(scene).values())
    square = len({*mla.count}) == 1 and len({*sensor.pixels}) == 1 and len(sections(mla)) == 1
    return centred and square and revolved and lens.number_off_revolution is None


class _Shared(NamedTuple):
    """Pictures of a plane's points shifted from near the axis, and the error of one of them."""

    mean: Array
    off: float


def _repeated(
    camera: WaveCamera, points: Array, repeats: Repeats, spread: Callable[[WaveCamera, Array], Array]
) -> _Shared | None:
    """Return the pictures of a plane's points, shifted from near the axis, or None for too few points.

    Parameters
    ----------
    camera : WaveCamera
    points : (n, 3) float64, mm
        All at the same distance.
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
    # Wide enough that every picture lies within that of the point near the axis.
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
    # The error from the array's rim and other departures from periodicity is largest at the largest shift.
    farthest = int((3 * np.abs(steps).max(axis=1) + mirrored.sum(axis=1) + turned).argmax())
    own = spread(camera, points[farthest])
    return _Shared(mean, float(np.abs(mean[farthest] - own).sum() / own.sum()))


def _planes(points: Array) -> Iterator[Numbers]:
    """Yield the indices of the points at each distance."""
    depth = np.round(points[:, 2] / (SAME * np.abs(points[:, 2]).max()))
    for z in np.unique(depth):
        yield np.flatnonzero(depth == z)
