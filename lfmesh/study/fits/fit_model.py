"""Parameters of a fit of a camera, and the places of its micro-images as their function.

What is found on a white image lies beside the chief rays: pixels sample the borders of a micro-image, and light falls
off over it. The fit compares like with like: to the chief rays it adds what the same search finds beside them on a
simulated white image of the camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError, PictureWarning, SceneError, collected
from lfmesh.lightfield.calibration.calibration import calibrate
from lfmesh.lightfield.calibration.white import white_image
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.scene import Scene
from lfmesh.study.fits.micro_image_phase import micro_image_places
from lfmesh.study.sweeps.axes import is_number
from lfmesh.study.sweeps.paths import value_at

Array = NDArray[np.float64]

TILT_DEG, PITCH_ERROR = 1.0, 0.01
"""Largest plausible tilt or rotation, and pitch error, of an array."""

DISTANCE = 0.2
"""Largest plausible error of the distance from lenslets to sensor, over that distance."""

ASIDE = 0.5
"""Of the range: how far a camera is moved to see what chief rays do not show."""

HARDLY_PX = 0.1
"""Directions along which this moves chief rays by less, rms, need to be looked at."""

SLOPE_IMAGE = 1
"""Number of the simulated images that are compared for it: the same random numbers, so that noise is partly shared."""

DEGREE = 3
"""Of the polynomial in columns and rows."""

STEP = 0.05
"""Of the range: half of what a central difference spans. Centres are nearly linear in all that is fitted."""


@dataclass(frozen=True)
class Parameter:
    """A number of the camera that is fitted.

    Attributes
    ----------
    name : str
    path : str
        Of the scene's field.
    unit : str
        "" for a ratio.
    start : float
        What the scene has.
    reach : float
        Largest plausible difference from that. A direction in which the picture tells less is not determined.
    """

    name: str
    path: str
    unit: str
    start: float
    reach: float


def parameters_of(scene: Scene, also: Mapping[str, float] | None = None) -> tuple[Parameter, ...]:
    """Return the assembly errors of a solved scene's array, and further fields.

    Parameters
    ----------
    scene : Scene
    also : mapping, optional
        Largest plausible change of further fields by their paths, as {"camera.sensor.distance_mm": 0.05}.

    Raises
    ------
    LfmeshError
        A conventional camera, a path that leads to no number, a range that is not positive.
    """
    mla = scene.camera.mla
    if mla is None:
        raise LfmeshError("camera.mla is missing: a white image shows the assembly errors of a microlens array only")
    pose, form, gap = "camera.mla.pose", "camera.mla.form", RayModel.of(scene).lenslet_to_sensor_mm
    own = (
        ("array: rotation", f"{pose}.tilt_deg[2]", "deg", TILT_DEG),
        ("array: tilt about x", f"{pose}.tilt_deg[0]", "deg", TILT_DEG),
        ("array: tilt about y", f"{pose}.tilt_deg[1]", "deg", TILT_DEG),
        ("array: shift in x", f"{pose}.shift_mm[0]", "mm", mla.pitch_mm),
        ("array: shift in y", f"{pose}.shift_mm[1]", "mm", mla.pitch_mm),
        ("array: distance", f"{pose}.shift_mm[2]", "mm", DISTANCE * gap),
        ("array: pitch error", f"{form}.pitch_error", "", PITCH_ERROR),
    )
    listed = [Parameter(name, path, unit, float(value_at(scene, path)), reach) for name, path, unit, reach in own]
    for path, reach in (also or {}).items():
        listed.append(_further(scene, path, reach))
    paths = [each.path for each in listed]
    if twice := [path for path in paths if paths.count(path) > 1]:
        raise LfmeshError(f"also: {twice[0]} is fitted already")
    return tuple(listed)


def _further(scene: Scene, path: str, reach: float) -> Parameter:
    try:
        value = value_at(scene, path)
    except (KeyError, SceneError) as error:
        raise LfmeshError(f"also: {error.args[0]}") from None
    if not is_number(value) or not np.isfinite(value):
        raise LfmeshError(f"also: {path} is {value!r}, no finite number that can be fitted")
    if not (np.isfinite(reach) and reach > 0.0):
        raise LfmeshError(f"also: {path} = {reach:g}: give its largest plausible change, above 0")
    field = path.rsplit(".", 1)[-1].split("[")[0]
    unit = next((unit for unit in ("mm", "deg", "nm") if field.endswith(f"_{unit}")), "")
    return Parameter(path, path, unit, float(value), float(reach))


@dataclass(frozen=True)
class FitModel:
    """Micro-images of a camera as a function of its parameters.

    Attributes
    ----------
    scene : Scene
        Solved; where the fit starts.
    parameters : tuple of Parameter
    samples : int
        A pixel, of the simulated white images.
    warned : dict
        Warnings of the white images simulated so far, by the name of each.
    """

    scene: Scene
    parameters: tuple[Parameter, ...]
    samples: int
    warned: dict[str, tuple[PictureWarning, ...]] = field(default_factory=dict)

    @property
    def reach(self) -> Array:
        """(p,): the ranges, in which steps and singular values are counted."""
        return np.array([each.reach for each in self.parameters])

    def at(self, steps: Array) -> Scene:
        """Return the camera at (p,) differences from the start, in ranges."""
        moved = zip(self.parameters, steps * self.reach, strict=True)
        try:
            return self.scene.changed({each.path: each.start + float(step) for each, step in moved})
        except SceneError as error:
            line = str(error).splitlines()[0]
            raise LfmeshError(f"no camera near the scene's fits the picture; the search came to {line}") from None

    def centres(self, steps: Array) -> Array:
        """Return where the chief rays land, (rows, columns, 2) pixels; NaN: there is none."""
        found = calibrate(self.at(steps))
        return np.where(found.known[..., None], found.centres_px, np.nan)

    def derivative(self, steps: Array) -> Array:
        """Return the derivative of the centres by the parameters in ranges, (rows, columns, 2, p) pixels."""
        columns = [
            (self.centres(steps + unit) - self.centres(steps - unit)) / (2.0 * STEP)
            for unit in STEP * np.eye(len(steps))
        ]
        return np.stack(columns, axis=-1)

    def simulated(self, steps: Array, number: int) -> Array:
        """Return a simulated white image of the camera, (H, W), as the raw image lies.

        Parameters
        ----------
        steps : (p,) float64
        number : int
            From 1. Each has its own random numbers, which are others than those of a render of the same scene.
        """
        camera = self.at(steps)
        settings = {
            "transport.samples": self.samples,
            "transport.split": "transmit",
            "transport.replicates": 2,
            "transport.seed": camera.transport.seed + number,
            "transport.target_error": None,
        }
        with collected():
            image = white_image(camera.changed(settings))
        self.warned[f"image {len(self.warned) + 1}"] = image.warnings
        return np.ascontiguousarray(image.mean.sum(axis=2))

    def beside(self, light: Array, steps: Array) -> Array:
        """Return how far micro-images of a simulated white image lie beside the chief rays, (rows, columns, 2) pixels.

        Parameters
        ----------
        light : (H, W) float64
            From `simulated` at the same steps.
        steps : (p,) float64
        """
        centres = self.centres(steps)
        return np.asarray(micro_image_places(light, self.scene, centres) - centres)

    def beside_slopes(self, steps: Array, derivative: Array) -> Array:
        """Return how places beside the chief rays change with the parameters in ranges, (rows, columns, 2, p) pixels.

        Only along directions that hardly move chief rays; along the others it is a small part of what they move. Noise
        is that of the simulated images.

        Parameters
        ----------
        steps : (p,) float64
        derivative : (lenslets, 2, p) float64
            Of the chief rays' places.
        """
        rows = derivative.reshape(-1, len(steps))
        _, singular, directions = np.linalg.svd(rows, full_matrices=False)
        slopes = np.zeros((*self.centres(steps).shape, len(steps)))
        for way in directions[ASIDE * singular < HARDLY_PX * np.sqrt(len(rows))]:
            ends = [steps + sign * ASIDE * way for sign in (1.0, -1.0)]
            up, down = (self.beside(self.simulated(end, SLOPE_IMAGE), end) for end in ends)
            slopes += ((up - down) / (2.0 * ASIDE))[..., None] * way
        return slopes


def smooth(values: Array) -> Array:
    """Return the polynomials of columns and rows nearest to values over the array, (rows, columns, ...).

    Parameters
    ----------
    values : (rows, columns, ...) float64
        NaN says nothing.
    """
    height, width = values.shape[:2]
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, height), np.linspace(-1.0, 1.0, width), indexing="ij")
    terms = np.stack([x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)], axis=-1)
    several = values.reshape(height, width, -1)
    known = np.isfinite(several).all(axis=-1)
    fitted, *_ = np.linalg.lstsq(terms[known], several[known], rcond=None)
    return np.asarray((terms @ fitted).reshape(values.shape))
