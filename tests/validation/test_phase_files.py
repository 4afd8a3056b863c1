"""Rays through phase surfaces against the radii that OpticStudio stores for its images.

A Zemax file stores the semi-diameter of its image: the largest height of the marginal rays of its fields and
wavelengths, which are aimed at the paraxial entrance pupil. Versions up to 2013 trace the upper and the lower ray, that
of the gratings the left and the right one, too. The prescriptions are Zemax's samples, and two of optiland's tests.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.imports import zemax
from lfmesh.optics.glass import refractive_index
from tests.validation.stored_images import Sample, largest_height, rays, text_of

SAME_MM = 1e-8


def extra(*values: float) -> str:
    return "".join(f"\n  XDAT {k} {value!r} 0 0" for k, value in enumerate(values, 1))


BINARY_1 = (
    7.112255105933e3, 7.112255102509e3, -7.084507848802e3, 55.12737188901, -7.084496933368e3, -54.87259430759,
    -54.64993165213, -53.79627317568, -54.27566005697, 26.56917293157, -1.243494818118, 53.14654614184,
    -1.240248904741, 26.55885130194, 0.6184546727486, 0.9455739118475, 0.9546274208762, 1.373300627383,
)  # fmt: skip
ZERNIKE = (
    -2.4073e-2, 0.752071, -1.504, -2.4391e-2, 1.2279e-2, 1.6372e-2, 0.386047, -0.77209, -5.68e-4, 0.0, 0.0, 2.32e-4,
    3.09e-4, 6.814e-3, -1.3628e-2, 1.66e-4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.06e-4, -2.12e-4, 4.41e-4,
)  # fmt: skip
IN_BK7 = "\n  GLAS N-BK7 0 0 1.5 40"
GRATING = "STOP\n  TYPE DGRATING\n  PARM 1 0.2\n  PARM 2 -1\n  DISZ 30\n  DIAM 9"
ALL_EDGES = ((0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0))
PLATE = ("TYPE STANDARD\n  DISZ 5\n  DIAM 12" + IN_BK7,)
GLASS_AT_MM = 5.0 / refractive_index("SCHOTT/N-BK7", 587.0)
"""Place of the image of the back of the plate, the entrance pupil."""

SAMPLES = {
    "Achromatic singlet": Sample(
        text_of(
            50.0, [0.4861, 0.5876, 0.6563], "250",
            "STOP\n  TYPE STANDARD\n  CURV 7.5762934618539999e-3\n  DISZ 25\n  DIAM 32" + IN_BK7,
            "TYPE BINARY_2\n  CURV -6.6766952605729997e-3\n  PARM 0 1"
            + extra(3, 30.0, -2.993832387049e3, 1.135544608547e3, -59.321054543)
            + "\n  DISZ 250.73834507\n  DIAM 32",
        ),
        250.73834507, 5.175465768436, 25.0, 0.0, 250.0, ((0.0, 0.0), (0.0, 3.5), (0.0, 5.0)),
    ),
    "sc_diffract2": Sample(
        text_of(
            20.0, [0.4861327, 0.5875618, 0.6562725], "INFINITY",
            "STOP\n  TYPE BINARY_2\n  CURV 3.7074963352499997e-2\n  PARM 0 1"
            + extra(2, 10.0, -1.13335145593e3, 3.419196287623e2) + "\n  DISZ 10\n  DIAM 11" + IN_BK7,
            "TYPE STANDARD\n  CURV -8.3727806707704251e-3\n  DISZ 34.38818248431\n  DIAM 10",
        ),
        34.38818248431, 4.693575984866e-2, 10.0, 0.0, math.inf, ((0.0, 0.0),),
    ),
    "sc_diffract3": Sample(
        text_of(
            20.0, [0.55], "INFINITY",
            "STOP\n  TYPE BINARY_1\n  PARM 0 1" + extra(18, 10.0, *BINARY_1) + "\n  DISZ 80\n  DIAM 11",
        ),
        80.0, 7.07057849426, 10.0, 0.0, math.inf, ((0.0, 0.0),),
    ),
    "sc_zern2": Sample(
        text_of(
            40.0, [0.55], "INFINITY",
            "TYPE FZERNPHA\n  PARM 0 1\n  PARM 1 1" + extra(25, 20.0, *ZERNIKE) + "\n  DISZ 0\n  DIAM 22",
            "STOP\n  TYPE STANDARD\n  CURV 1.485671099e-2\n  DISZ 10\n  DIAM 22" + IN_BK7,
            "TYPE STANDARD\n  CURV -2.0168851199e-3\n  DISZ 50\n  DIAM 22",
            "TYPE STANDARD\n  CURV -1.92441958e-2\n  DISZ 5\n  DIAM 11" + IN_BK7,
            "TYPE STANDARD\n  CURV 1.36676344250e-2\n  DISZ 20\n  DIAM 11",
        ),
        20.0, 10.01993642299, 20.0, 0.0, math.inf, ((0.0, 0.0),),
    ),
    "Transmission hologram": Sample(
        text_of(
            50.0, [0.55], "200",
            "STOP\n  TYPE HOLOGRM2\n  PARM 3 -200\n  PARM 6 100\n  PARM 7 0.55\n  PARM 8 1\n  DISZ 100\n  DIAM 26",
        ),
        100.0, 5.505476815018, 25.0, 0.0, 200.0, ((0.0, 0.0), (0.0, 10.0)),
    ),
    "flat grating": Sample(
        text_of(15.0, [0.587], "INFINITY", *PLATE, GRATING),
        30.0, 13.319073572664644, 7.5, GLASS_AT_MM, math.inf, ((0.0, 0.0), (0.0, 10.0), (10.0, 0.0)), ALL_EDGES,
    ),
    "curved grating": Sample(
        text_of(15.0, [0.587], "INFINITY", *PLATE, GRATING.replace("  PARM 1", "  CURV 0.02\n  CONI 1\n  PARM 1")),
        30.0, 15.906291922754132, 7.5, GLASS_AT_MM, math.inf, ((0.0, 0.0), (0.0, 10.0), (10.0, 0.0)), ALL_EDGES,
    ),
}  # fmt: skip


@pytest.mark.parametrize("engine", ["sequential", "mesh"])
@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.filterwarnings("ignore::lfmesh.errors.LensFileWarning")
def test_the_image_is_as_large_as_opticstudio_stores_it(name: str, engine: Any) -> None:
    sample = SAMPLES[name]
    lens, report = zemax.read(Path("lens.zmx"), sample.text.splitlines())
    assert report.conditions is not None
    assert report.conditions.image_mm == sample.image_mm
    # Clear apertures that every ray passes, as the program does not aim at its stop.
    lens = lens.model_copy(update={"stop_semi_diameter_mm": 1.2 * sample.pupil_mm})
    sensor = {"pixels": (1000, 1000), "pixel_mm": 0.05, "distance_mm": sample.image_mm}
    world = lf.build(lf.Scene(camera={"lens": lens, "sensor": sensor}), aimed=False)
    heights = [largest_height(world, sample, nm, engine=engine) for nm in report.conditions.wavelengths_nm]
    assert max(heights) == pytest.approx(sample.stored_mm, rel=0.0, abs=SAME_MM)


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.filterwarnings("ignore::lfmesh.errors.LensFileWarning")
def test_the_opposite_phase_misses_the_stored_size(name: str) -> None:
    """A test of the sign: the image is then another one by far more than the tolerance."""
    sample = SAMPLES[name]
    lens, _ = zemax.read(Path("lens.zmx"), sample.text.splitlines())
    surfaces = [
        surface if surface.phase is None else surface.model_copy(
            update={"phase": surface.phase.model_copy(update={"order": -surface.phase.main_order})}
        )
        for surface in lens.surfaces
    ]  # fmt: skip
    lens = lens.model_copy(update={"surfaces": tuple(surfaces), "stop_semi_diameter_mm": 1.2 * sample.pupil_mm})
    sensor = {"pixels": (4000, 4000), "pixel_mm": 0.05, "distance_mm": sample.image_mm}
    world = lf.build(lf.Scene(camera={"lens": lens, "sensor": sensor}), aimed=False)
    paths = lf.trace(world, *rays(sample), wavelength_nm=550.0, split="transmit", engine="sequential")
    landed = paths.status == lf.Status.SENSOR
    assert landed.any()
    assert abs(np.hypot(*paths.position[landed, :2].T).max() - sample.stored_mm) > 1e-4
