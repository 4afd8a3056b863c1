"""Background-oriented schlieren: the deflection of light by a flow, from the pictures of a background with and without.

A picture shows the background through the flow, a reference without it. Where light is deflected, the camera sees
another point of the background, and its dots appear displaced (G. E. A. Meier, Exp. Fluids 33, 181, 2002; M. Raffel,
Exp. Fluids 56, 60, 2015). With a distance L from the middle of the flow to the background, light that is turned by the
slope ε displaces the point that a pixel sees by δ = L ε on the background, and the dots by −δ. In a thin flow, ε is the
integral of the index gradient across the line of sight.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError, warn_caller
from lfmesh.geometry import frame as frames
from lfmesh.geometry.index_media import bends, index_medium
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.photographs.displacement import MARGIN, displacements, window_centres
from lfmesh.lightfield.views.field import LightField
from lfmesh.lightfield.views.upright import Upright
from lfmesh.notebook import Pictured, Say, announced
from lfmesh.scene import Scene
from lfmesh.scene.first_order.solve import image_plane_mm
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

LEAST_WINDOW, MOST_WINDOW = 9, 255
"""Widths of a window, in samples."""

MOST_REACH = 100
"""Largest displacement that may be searched, in samples."""

RESAMPLED = 3.0**0.5
"""Variance of sums of neighbouring samples of hexagonal lenslets, over that of independent ones.

Samples are weighted means of two lenslets, with the mean squared weight 2/3, and √3/2 of a lenslet apart: 1.5 / (√3/2).
"""


@dataclass(frozen=True, eq=False)
class Schlieren(Pictured):
    """Displacements of a background and the deflections of light that explain them, in windows of upright pictures.

    Components are along +x (to the right) and +y (up). Arrays have the axes (rows, columns, component) and, of a light
    field, (v, u) before them. NaN where a window shows no common pattern, or a false match.

    Attributes
    ----------
    displacement_px : (..., rows, columns, 2) float64
        Displacement of the background's dots from the reference to the run, in samples of the picture.
    displacement_error_px : (..., rows, columns, 2) float64
        Standard error by the noise of both pictures, times the misfit if that is above 1.
    deflection_rad : (..., rows, columns, 2) float64
        Change of the slopes dx/dz and dy/dz of light on its way from the background to the camera; towards the higher
        index.
    deflection_error_rad : (..., rows, columns, 2) float64
        Standard error, for exact distances.
    misfit : (..., rows, columns) float64
        Root mean square of the residual over that expected of the noise: near 1 where windows are displaced and
        brightened alone. NaN without noise.
    t_px, s_px : (rows,), (columns,) int64
        Row and column of the windows' middle samples in the upright picture, from the top left.
    sample_mm : (2,) float64
        Width and height of a sample on the background, by first-order optics.
    background_mm, field_mm : float
        Distances of background and flow before the first vertex.
    """

    displacement_px: Array
    displacement_error_px: Array
    deflection_rad: Array
    deflection_error_rad: Array
    misfit: Array
    t_px: NDArray[np.int64]
    s_px: NDArray[np.int64]
    sample_mm: Array
    background_mm: float
    field_mm: float

    def __repr__(self) -> str:
        *views, rows, columns = self.misfit.shape
        of_views = f"{views[1]} × {views[0]} views of " if views else ""
        return f"<Schlieren: {of_views}{columns} × {rows} windows, {np.isfinite(self.misfit).mean():.1%} of them known>"

    @property
    def middle(self) -> tuple[int, ...]:
        """Index of the middle view; () of a single picture."""
        return tuple(count // 2 for count in self.misfit.shape[:-2])

    def in_words(self) -> str:
        """Return the largest deflection, in the middle view of a light field, the errors and the distances in words.

        Returns
        -------
        str
        """
        known = np.isfinite(self.deflection_rad)
        if not known[self.middle].any():
            return "No window shows the same pattern in both pictures; give larger windows or a larger reach."
        # Views at the rim of the pupil have little light, and outliers.
        largest = float(np.nanmax(np.abs(self.deflection_rad[self.middle])))
        farthest = float(np.nanmax(np.abs(self.displacement_px[self.middle])))
        return (
            f"Light is deflected by up to {1e3 * largest:.4g} mrad, with a median standard error of "
            f"{1e3 * float(np.median(self.deflection_error_rad[known])):.2g} mrad, and dots are displaced by up to "
            f"{farthest:.3g} samples. The background lies at "
            f"{self.background_mm:.6g} mm, the flow at {self.field_mm:.6g} mm. {known[..., 0].mean():.1%} of the "
            f"windows are known; their median misfit is {float(np.nanmedian(self.misfit)):.3g}."
        )


def schlieren(
    run: Image | LightField, reference: Image | LightField, *, window: int = 21, step: int | None = None,
    reach: int = 5, background_mm: float | None = None, field_mm: float | None = None,
    progress: Say | bool | None = None,
) -> Schlieren:  # fmt: skip
    """Evaluate two pictures of a background, with and without a flow in front of it.

    Channels are added up. Their errors are added too, as they may be correlated.

    Parameters
    ----------
    run, reference : Image or LightField
        With and without the flow: both images of a conventional camera, or both light fields (`lf.decode`). Render them
        with different seeds.
    window : int
        Width of a window in samples, odd. Displacements are resolved that vary over half of it or more.
    step : int, optional
        Distance between neighbouring windows, in samples (default: a third of a window).
    reach : int
        Largest displacement along each axis, in samples.
    background_mm : float, optional
        Distance of the background before the first vertex (default: the plane in focus).
    field_mm : float, optional
        Distance of the middle of the flow before the first vertex (default: the middle of the boxes of all media of the
        run that bend light).
    progress : callable or bool, optional
        Called with the progress in words. True shows it, False nothing. Default: it is shown at a terminal or in a
        notebook after two seconds.

    Returns
    -------
    Schlieren

    Warns
    -----
    UserWarning
        Both runs have the same seed.

    Raises
    ------
    LfmeshError
        The runs are of different kinds or cameras, have no standard errors, are too small for a window, or a distance
        is unknown.
    """
    step = max(window // 3, 1) if step is None else step
    _refuse_settings(window, step, reach)
    _refuse_pair(run, reference)
    scene = solved_camera(run.scene).scene
    background = _background_mm(scene, background_mm)
    flow = _field_mm(scene, field_mm, background)
    sample = _sample_mm(run, scene, background)
    pictures, errors = zip(_pictures(run), _pictures(reference), strict=True)
    if any(not np.isfinite(error[np.isfinite(picture)]).any() for picture, error in zip(pictures, errors, strict=True)):
        raise LfmeshError("a run has no standard errors: render it with transport.replicates of 2 or more")
    height, width = pictures[0].shape[-2:]
    t, s = window_centres(height, window, step), window_centres(width, window, step)
    if not (len(t) and len(s)):
        raise LfmeshError(
            f"window = {window}: no window fits into {width} × {height} samples, with {MARGIN} around it; give at most "
            f"{min(width, height) - 2 * MARGIN}"
        )
    views = pictures[0].shape[:-2]
    shift, error = np.empty((2, *views, len(t), len(s), 2))
    misfit = np.empty((*views, len(t), len(s)))
    with announced(progress) as say:
        for number, view in enumerate(np.ndindex(views)):
            say(f"displacements: picture {number + 1} of {math.prod(views)}")
            pair = (pictures[0][view], pictures[1][view]), (errors[0][view], errors[1][view])
            shift[view], error[view], misfit[view] = displacements(*pair, (t, s), window=window, reach=reach)
    # The dots move against the point that a window sees; rows count downwards.
    displacement = shift * (-1.0, 1.0)
    per_sample = sample / (background - flow)
    return Schlieren(
        displacement, error, -displacement * per_sample, error * per_sample, misfit, t, s, sample, background, flow
    )


def _refuse_settings(window: int, step: int, reach: int) -> None:
    if not (LEAST_WINDOW <= window <= MOST_WINDOW and window % 2):
        raise LfmeshError(f"window = {window}: must be an odd number from {LEAST_WINDOW} to {MOST_WINDOW}")
    if step < 1:
        raise LfmeshError(f"step = {step}: must be 1 or more")
    if not 1 <= reach <= MOST_REACH:
        raise LfmeshError(f"reach = {reach}: must be from 1 to {MOST_REACH}")


def _refuse_pair(run: Image | LightField, reference: Image | LightField) -> None:
    """Refuse pictures that cannot be compared; warn of noise that both have in common."""
    for name, each in (("run", run), ("reference", reference)):
        if isinstance(each, Image) and each.scene.camera.mla is not None:
            raise LfmeshError(f"{name}: an image behind a microlens array; give its light field, lf.decode(image)")
        if not isinstance(each, Image | LightField):
            raise LfmeshError(f"{name}: a {type(each).__name__}; give an Image or a LightField")
    shapes = [(each.mean if isinstance(each, Image) else each.data).shape for each in (run, reference)]
    cameras = [solved_camera(each.scene).scene.camera for each in (run, reference)]
    if shapes[0] != shapes[1] or cameras[0] != cameras[1]:
        raise LfmeshError(
            "run and reference are of different cameras; render the same camera with and without the flow"
        )
    if isinstance(run, LightField) and isinstance(reference, LightField) and run.unit != reference.unit:
        raise LfmeshError(f"the run is in {run.unit}, the reference in {reference.unit}; divide both by a white image")
    seed = run.scene.transport.seed
    if seed == reference.scene.transport.seed:
        why = (
            f"run and reference have the same seed, {seed}, so their noise is alike and draws small displacements to 0"
        )
        warn_caller([UserWarning(f"{why}; render one of them with another transport.seed")])


def _background_mm(scene: Scene, given: float | None) -> float:
    distance = float(solved_camera(scene).facts.object_distance_mm if given is None else given)
    if not 0.0 < distance < math.inf:
        raise LfmeshError(f"background_mm = {distance:g}: must be a distance in front of the camera, above 0 mm")
    return distance


def _field_mm(scene: Scene, given: float | None, background: float) -> float:
    distance = _middle_of_flow_mm(scene) if given is None else float(given)
    if not 0.0 < distance < background:
        raise LfmeshError(
            f"field_mm = {distance:g}: the flow must lie between the camera and the background, at {background:g} mm"
        )
    return distance


def _middle_of_flow_mm(scene: Scene) -> float:
    """Return the distance of the middle of all boxes that bend light before the first vertex."""
    numbers = [number for number, medium in enumerate(scene.media) if bends(scene, medium)]
    if not numbers:
        raise LfmeshError("field_mm is missing: no medium of the run bends light, so give the distance of the flow")
    corners = [index_medium(scene, number, (scene.primary_nm,)).corners_mm() for number in numbers]
    to_camera = frames.inverse(frames.frame(scene.camera.pose.tilt_deg, scene.camera.pose.shift_mm))
    z = frames.points(to_camera, np.concatenate(corners))[:, 2]
    return float(-0.5 * (z.min() + z.max()))


def _sample_mm(run: Image | LightField, scene: Scene, background: float) -> Array:
    """Return the width and height of a sample on the background."""
    camera = solved_camera(scene)
    if camera.facts.efl_x_mm is not None:
        raise LfmeshError("camera.lens: an anamorphic lens has two scales; schlieren needs a lens with one")
    if isinstance(run, LightField):
        along_t, along_s = run.spacing_mm
        return np.abs(run.model.object_scale(background)) * np.array([along_s, along_t])
    image = image_plane_mm(scene.camera, scene.primary_nm)
    # Heights on the sensor over those on the background.
    scale = abs(camera.paraxial.chief_scale_mm(background, image)) / background
    if not 0.0 < scale < math.inf:
        raise LfmeshError("camera.lens: its chief rays give the background no size; schlieren needs an imaging lens")
    return np.full(2, scene.camera.sensor.pixel_mm / scale)


def _pictures(run: Image | LightField) -> tuple[Array, Array]:
    """Return upright pictures and their standard errors, summed over channels, (..., H, W)."""
    if isinstance(run, LightField):
        assert run.scene.camera.mla is not None
        more = RESAMPLED**0.5 if run.scene.camera.mla.layout == "hexagonal" else 1.0
        return run.data.sum(axis=-1, dtype=np.float64), more * run.stderr.sum(axis=-1, dtype=np.float64)
    upright = Upright.of(run.scene).picture
    return upright(run.mean.sum(axis=-1)), upright(run.stderr.sum(axis=-1))
