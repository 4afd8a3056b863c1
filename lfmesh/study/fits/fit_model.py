"""Parameters of a camera fit, and the micro-images' positions as a function of them.

Micro-images are offset from the chief rays: pixels sample their borders, and light falls off over them. The model adds
the offsets found on a simulated white image.
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
"""Largest plausible tilt or rotation (degrees), and pitch error, of an array."""

DISTANCE = 0.2
"""Largest plausible relative error of the distance from lenslets to sensor."""

ASIDE = 0.5
"""Displacement of the camera, in ranges, for effects that chief rays do not show."""

HARDLY_PX = 0.1
"""Rms motion of the chief rays by this displacement below which a direction is examined."""

SLOPE_IMAGE = 1
"""Number of the simulated images compared for it: common random numbers cancel part of the noise."""

DEGREE = 3
"""Degree of the polynomial in columns and rows."""

STEP = 0.05
"""Central-difference half-step, in ranges. Centres are nearly linear in all parameters."""


@dataclass(frozen=True)
class Parameter:
    """Fitted number of a camera.

    Attributes
    ----------
    name : str
    path : str
        Path of the scene's field.
    unit : str
        "" for a ratio.
    start : float
        Value in the scene.
    reach : float
        Largest plausible difference from it; anything known less well counts as undetermined.
    """

    name: str
    path: str
    unit: str
    start: float
    reach: float


def parameters_of(scene: Scene, also: Mapping[str, float] | None = None) -> tuple[Parameter, ...]:
    """Return the assembly errors of a solved scene's array, followed by further fields.

    Parameters
    ----------
    scene : Scene
    also : mapping, optional
        Largest plausible changes of further fields, by path, as {"camera.sensor.distance_mm": 0.05}.

    Raises
    ------
    LfmeshError
        The camera is conventional, a path is not a number's, or a range is not positive.
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
        raise LfmeshError(f"also: {path} is {value!r}; only finite numbers can be fitted")
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
        Start of the fit, solved.
    parameters : tuple of Parameter
    samples : int
        Samples per pixel of the simulated white images.
    warned : dict
        Warnings of the white images simulated so far, by name.
    """

    scene: Scene
    parameters: tuple[Parameter, ...]
    samples: int
    warned: dict[str, tuple[PictureWarning, ...]] = field(default_factory=dict)

    @property
    def reach(self) -> Array:
        """(p,): plausible ranges, the units of steps and singular values."""
        return np.array([each.reach for each in self.parameters])

    def at(self, steps: Array) -> Scene:
        """Return the camera displaced from the start by (p,) steps, in ranges."""
        moved = zip(self.parameters, steps * self.reach, strict=True)
        try:
            return self.scene.changed({each.path: each.start + float(step) for each, step in moved})
        except SceneError as error:
            line = str(error).splitlines()[0]
            raise LfmeshError(f"no camera near the scene's fits the picture; the search ended at {line}") from None

    def centres(self, steps: Array) -> Array:
        """Return the chief rays' points on the sensor, (rows, columns, 2) pixels; NaN: none."""
        found = calibrate(self.at(steps))
        return np.where(found.known[..., None], found.centres_px, np.nan)

    def derivative(self, steps: Array) -> Array:
        """Return the derivative of the centres by the parameters, (rows, columns, 2, p) pixels per range."""
        columns = [
            (self.centres(steps + unit) - self.centres(steps - unit)) / (2.0 * STEP)
            for unit in STEP * np.eye(len(steps))
        ]
        return np.stack(columns, axis=-1)

    def simulated(self, steps: Array, number: int) -> Array:
        """Return a simulated white image of the camera, (H, W), oriented like the raw image.

        Parameters
        ----------
        steps : (p,) float64
        number : int
            From 1. Each image has its own random numbers, other than a render's.
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
        """Return the offsets of a simulated white image's micro-images from the chief rays, (rows, columns, 2) pixels.

        Parameters
        ----------
        light : (H, W) float64
            From `simulated` at the same steps.
        steps : (p,) float64
        """
        centres = self.centres(steps)
        return np.asarray(micro_image_places(light, self.scene, centres) - centres)

    def beside_slopes(self, steps: Array, derivative: Array) -> Array:
        """Return the derivative of the offsets from chief rays by the parameters, (rows, columns, 2, p) pixels.

        It is computed only along directions that hardly move chief rays (elsewhere it is negligible), and has the
        simulated images' noise.

        Parameters
        ----------
        steps : (p,) float64
        derivative : (lenslets, 2, p) float64
            Derivative of the chief rays' positions.
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
    """Return least-squares polynomials in columns and rows for values over the array, (rows, columns, ...).

    Parameters
    ----------
    values : (rows, columns, ...) float64
        NaN: ignored.
    """
    height, width = values.shape[:2]
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, height), np.linspace(-1.0, 1.0, width), indexing="ij")
    terms = np.stack([x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)], axis=-1)
    several = values.reshape(height, width, -1)
    known = np.isfinite(several).all(axis=-1)
    fitted, *_ = np.linalg.lstsq(terms[known], several[known], rcond=None)
    return np.asarray((terms @ fitted).reshape(values.shape))
