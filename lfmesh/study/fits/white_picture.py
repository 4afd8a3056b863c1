"""Light of a camera's white image, checked and in sensor orientation."""

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.lightfield.detector import Exposed
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

Orientation = Literal["upright", "upside_down", "sensor"]

FULL = tuple(2**bits - 1 for bits in (8, 10, 12, 14, 16))
"""Full-scale counts of converters."""

SATURATED = 0.01
"""Fraction of pixels at full scale above which a picture is refused."""


def light_of(
    white: Image | Exposed | NDArray[Any], scene: Scene, orientation: Orientation, name: str = "white image"
) -> Array:
    """Return the light of a white image or another picture, (H, W), in sensor orientation.

    Parameters
    ----------
    white : Image, Exposed or (H, W) or (H, W, channels) array
    scene : Scene
        Solved.
    orientation : {"upright", "upside_down", "sensor"}
        Orientation of an array.
    name : str
        Name of the picture in errors.

    Raises
    ------
    LfmeshError
        The picture has another size than the sensor, is a mosaic, black or saturated, or has invalid values.
    """
    if orientation not in get_args(Orientation):
        raise LfmeshError(f"orientation = {orientation!r}: must be one of {', '.join(get_args(Orientation))}")
    if isinstance(white, Image):
        light = white.mean.sum(axis=2)
    elif isinstance(white, Exposed):
        light = _exposed(white, name)
    else:
        light = _picture(np.asarray(white), scene, orientation, name)
    columns, rows = scene.camera.sensor.pixels
    if light.shape != (rows, columns):
        height, width = light.shape
        raise LfmeshError(f"the {name} has {width} × {height} pixels, but camera.sensor.pixels = [{columns}, {rows}]")
    if not np.isfinite(light).all():
        raise LfmeshError(f"the {name} has pixels that are infinite or not numbers")
    if not light.max() > 0.0:
        raise LfmeshError(f"the {name} is black")
    return np.ascontiguousarray(light, np.float64)


def _exposed(exposed: Exposed, name: str) -> Array:
    detector = exposed.detector
    if detector.bayer is not None:
        raise LfmeshError(f"bayer = {detector.bayer!r}: a fit takes a {name} without a mosaic of colour filters")
    _refuse_saturated(float(exposed.saturated.mean()), "their full well", name)
    return exposed.electrons


def _picture(picture: NDArray[Any], scene: Scene, orientation: Orientation, name: str) -> Array:
    if picture.ndim not in (2, 3) or not (np.issubdtype(picture.dtype, np.number) and np.isrealobj(picture)):
        raise LfmeshError(
            f"the {name} is an array of shape {picture.shape} and type {picture.dtype}: it must be (H, W) or "
            "(H, W, channels) real numbers"
        )
    if np.issubdtype(picture.dtype, np.integer) and picture.size and picture.max() in FULL:
        _refuse_saturated(float((picture == picture.max()).mean()), f"{picture.max()}, the highest count", name)
    light = np.asarray(picture, np.float64)
    if light.ndim == 3:
        light = light.sum(axis=2)
    if orientation == "sensor":
        return light
    return np.asarray(Upright.of(scene).picture(light if orientation == "upright" else light[::-1, ::-1]))


def _refuse_saturated(share: float, at: str, name: str) -> None:
    if share > SATURATED:
        raise LfmeshError(f"{share:.1%} of the {name}'s pixels are at {at}: it is saturated, expose it less")
