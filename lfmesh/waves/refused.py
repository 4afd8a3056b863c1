"""Values and scenes that a point spread refuses beforehand."""

import math

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.index_media import refuse_bending
from lfmesh.optics.curve import LONGEST_NM, SHORTEST_NM
from lfmesh.scene import Scene
from lfmesh.scene.quantities import LARGEST
from lfmesh.transport.tables.interfaces import refused_in_order
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.trace import check_numbers, check_whole, shown

Array = NDArray[np.float64]

MOST_PARTS = 50_000_000
"""Most parts of pixels in a picture."""


class NoLightError(LfmeshError):
    """No light of a point falls on the sensor."""


def no_light(point: Array) -> NoLightError:
    """Return the error for a point (camera frame, mm) with no light on the pixels."""
    return NoLightError(
        f"point_mm = {point.tolist()}: no light falls on the sensor's pixels; move the point into the field of view"
    )


def refuse_values(scene: Scene, point: Array, window: int | None, oversample: int, tolerance: float) -> None:
    """Refuse values out of range.

    Parameters
    ----------
    scene : Scene
    point : (3,) float64, mm, camera frame
    window : int, optional
        Pixels per side of the picture.
    oversample : int
        Parts of a pixel's side.
    tolerance : float
        Accepted change, as a fraction of the light.

    Raises
    ------
    LfmeshError
        A value is out of range.
    """
    check_whole(window=1 if window is None else window, oversample=oversample)
    check_numbers(tolerance=tolerance)
    if point.shape != (3,) or not np.isfinite(point).all() or not point[2] < 0.0:
        raise LfmeshError(
            f"point_mm = {point.tolist()}: give x, y and z in the camera frame, finite, with z below 0, before the lens"
        )
    if -point[2] > LARGEST:
        raise LfmeshError(f"point_mm = {point.tolist()}: z must be {-LARGEST:g} or more")
    if window is not None and not 1 <= window <= 100_000:
        raise LfmeshError(f"window = {shown(window)}: must be 1 pixel or more, up to 100,000")
    if not 1 <= oversample <= 64:
        raise LfmeshError(f"oversample = {shown(oversample)}: must be from 1 to 64 parts of a pixel's side")
    sides = [min(window or side, side) * oversample for side in scene.camera.sensor.pixels]
    if math.prod(sides) > MOST_PARTS:
        raise LfmeshError(
            f"window = {window}, oversample = {oversample}: a picture of {sides[0]} × {sides[1]} samples; the limit is "
            f"{MOST_PARTS:,}"
        )
    if not 0.0 < tolerance < 1.0:
        raise LfmeshError(f"tolerance = {shown(tolerance)}: must be between 0 and 1")


def lines_of_band(scene: Scene, name: str) -> tuple[list[float], list[float]]:
    """Return wavelengths, nm, and weights of a band of the sensor."""
    names = list(scene.channel_names)
    if name not in names:
        known = f"a band of the scene: {', '.join(names)}" if names else "a number: the scene has no bands"
        raise LfmeshError(f'wavelengths_nm = "{name}": must be {known}')
    lines = Lines.of(scene)
    nodes = lines.nodes[names.index(name)]
    chances = np.diff(nodes.until, prepend=0.0)
    return list(lines.wavelengths_nm[nodes.first : nodes.first + len(chances)]), chances.tolist()


def shares_of(wavelengths_nm: tuple[float, ...], given: list[float]) -> tuple[float, ...]:
    """Return the weights of wavelengths, scaled to add up to 1."""
    for wavelength in wavelengths_nm:
        if not SHORTEST_NM <= wavelength <= LONGEST_NM:
            raise LfmeshError(f"wavelengths_nm = {wavelength:g}: must be from {SHORTEST_NM:g} to {LONGEST_NM:g}")
    if not wavelengths_nm:
        raise LfmeshError("wavelengths_nm is empty: give one wavelength or more")
    if len(given) != len(wavelengths_nm):
        raise LfmeshError(f"weights = {given}: give one weight for each of wavelengths_nm = {list(wavelengths_nm)}")
    if not all(0.0 <= weight < math.inf for weight in given) or not max(given) > 0.0:
        raise LfmeshError(f"weights = {given}: must be finite, none below 0 and one above")
    # Relative to the largest, so that the sum of large weights is finite.
    shares = [weight / max(given) for weight in given]
    return tuple(share / sum(shares) for share in shares)


def numbers_of(name: str, given: object) -> Array:
    """Return numbers as an array, (n,)."""
    try:
        numbers = np.atleast_1d(np.asarray(given))
    except ValueError:
        numbers = np.empty((0, 0))
    # NumPy also accepts text, truth values and None as numbers; an empty list is valid.
    if numbers.dtype.kind not in "iuf" or numbers.ndim != 1:
        raise LfmeshError(f"{name} = {shown(given)}: must be a number, or a list of numbers")
    return numbers.astype(np.float64)


def refuse_scene(scene: Scene) -> None:
    """Refuse a scene with media, tanks, bodies of glass, gradient-index lenslets or a polariser."""
    refuse_bending(scene, "a point spread cannot be computed through it; omit it")
    if scene.media or scene.tanks:
        name = "media" if scene.media else "tanks"
        raise LfmeshError(f"{name}: a point spread cannot be computed through them; omit them")
    body = next((i for i, target in enumerate(scene.targets) if target.refractor is not None), None)
    if body is not None:
        raise LfmeshError(f"targets[{body}] is a body of glass: a point spread cannot be computed through it; omit it")
    if scene.camera.mla is not None and scene.camera.mla.gradient is not None:
        raise LfmeshError(
            "camera.mla.gradient: waves are not followed through gradient-index lenslets; trace rays, with "
            'transport.diffraction = "none"'
        )
    if scene.camera.polariser_deg is not None:
        raise LfmeshError(
            f"camera.polariser_deg = {scene.camera.polariser_deg:g}: a point spread has no polarisation; omit it"
        )


def refuse_rough_faces(scene: Scene) -> None:
    """Refuse a solved scene with rough faces."""
    rough = refused_in_order(scene)
    if rough is not None:
        raise LfmeshError(f"{rough}: coherent waves pass smooth faces only; make it polished")
