"""The focused plenoptic camera (2.0), with lenslets that image the main image, not the pupil, onto the sensor.

A. Lumsdaine, T. Georgiev, "The focused plenoptic camera", ICCP 2009. The main image lies a before the lenslets
(Keplerian) or behind them (Galilean), and the sensor b behind: 1/a + 1/b = 1/f, with a negative in the latter case. A
lenslet reduces by a/b, so about (a/b)² lenslets see each point of the main image: fewer views than in a standard
plenoptic camera, with more pixels each. Several focal lengths on one array are sharp at as many distances (C. Perwass,
L. Wietzke, "Single lens 3D-camera with extended depth-of-field", Proc. SPIE 8291, 2012).
"""

from collections.abc import Sequence
from typing import Literal

from lfmesh.errors import LfmeshError
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import Scene, solved
from lfmesh.scene.first_order.solve import lenslet_focal_length_mm

MOST_TYPES = 3


def focused(
    scene: Scene,
    reduction: float | Sequence[float] = 3.0,
    kind: Literal["keplerian", "galilean"] = "keplerian",
) -> Scene:
    """Turn a standard plenoptic camera into a focused one with the same sensor, lenslet pitch and aperture.

    Array and sensor move away from the image of the plane in focus, and the lenslets get the focal length that images
    it onto the sensor. Micro-images keep their size, except for the array's new distance from the pupil.

    Parameters
    ----------
    scene : Scene
        With the array at the image of the plane in focus.
    reduction : float or sequence of up to 3 floats
        a/b, above 1, the reduction of the main image by lenslets. Several make a multi-focus array, with the middle
        lenslets focused on the plane in focus and the others beyond and before it.
    kind : {"keplerian", "galilean"}
        The main image lies before the lenslets, or behind them as a virtual object.

    Returns
    -------
    Scene
        Solved.

    Raises
    ------
    LfmeshError
        A conventional camera, a reduction out of range, or no room for the array behind the lens.
    """
    scene = solved_camera(scene).scene
    model = RayModel.of(scene)
    camera = scene.camera
    reductions = [float(r) for r in (reduction if isinstance(reduction, Sequence) else [reduction])]
    if kind not in ("keplerian", "galilean"):
        raise LfmeshError(f'kind = {kind!r}: use "keplerian" or "galilean"')
    if not 1 <= len(reductions) <= MOST_TYPES or not all(1.0 < r < 1e3 for r in reductions):
        raise LfmeshError(f"reduction = {reductions}: give 1 to {MOST_TYPES} numbers above 1")
    assert camera.mla is not None
    if camera.mla.curved_phase is not None:
        raise LfmeshError(
            "camera.mla.curved_phase: the focal lengths of diffractive lenslets are not converted; give a camera with "
            "lenslets without a phase, or change the phase yourself"
        )
    if solved_camera(scene).report.focused:
        raise LfmeshError("the camera is already a focused plenoptic one: give a standard one, see `lfmesh check`")
    b = model.lenslet_to_sensor_mm
    toward = 1.0 if kind == "keplerian" else -1.0
    distance = (camera.mla.distance_mm or 0.0) + toward * sorted(reductions)[len(reductions) // 2] * b
    if not distance > 0.0:
        raise LfmeshError(
            f"reduction = {reductions}: the array would lie {-distance:.4g} mm inside the lens; give a smaller one"
        )
    # Keys of a scene are focal lengths in air: R / (n − 1) for R / (n/n' − 1) here.
    plate, outside = refractive_index(camera.mla.medium, scene.primary_nm), camera.image_index(scene.primary_nm)
    in_air = (plate / outside - 1.0) / (plate - 1.0)
    focal_lengths = [b / (1.0 + toward / r) * in_air for r in reductions]
    pixels = camera.mla.pitch_mm / camera.sensor.pixel_mm
    if sorted(reductions)[len(reductions) // 2] >= pixels:
        raise LfmeshError(
            f"reduction = {reductions}: the middle one must be below {pixels:g}, the pixels per lenslet; with more, "
            "the lenslets image the pupil as sharply as in a standard camera"
        )
    return solved(
        scene.changed(
            {
                # The distances define the camera; the focus is no longer on the lenslets.
                "camera.focus_mm": None,
                "camera.mla.distance_mm": distance,
                "camera.mla.radius_mm": None,
                "camera.mla.focal_length_mm": focal_lengths,
            }
        )
    )


def lenslet_blur_px(scene: Scene, excess_mm: float) -> tuple[float, ...]:
    """Return the blur width of a main-image point on the sensor, in pixels, for each type of lenslet.

    By first-order optics, for filled lenslets.

    Parameters
    ----------
    scene : Scene
        Solved.
    excess_mm : float
        Distance of the main image of the point behind the lenslets: `RayModel.image_excess_mm`.
    """
    mla, model = scene.camera.mla, RayModel.of(scene)
    if mla is None:
        raise LfmeshError("camera.mla is missing: a conventional camera has no lenslets")
    vergence = -1.0 / excess_mm if excess_mm else float("inf")
    wide = mla.pitch_mm * model.lenslet_to_sensor_mm / model.pixel_mm
    focal = lenslet_focal_length_mm(scene.camera, scene.primary_nm)
    return tuple(wide * abs(1.0 / model.lenslet_to_sensor_mm + vergence - 1.0 / f) for f in focal)
