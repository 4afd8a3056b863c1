"""Rays through gradient-index glass of Zemax files against the radii that OpticStudio stores for its images.

The prescriptions are retyped from the samples GRIN interconnect, Selfoc lens and sc_grin3 (repository
yiningli/Project_X, Zemax_Files), the materials from GRADIENT_9.DAT, SGRIN.DAT and PROFILE.GRD beside them. OpticStudio
integrates in steps of 0.1 mm, in sc_grin3 of 0.25 mm. `test_opticstudio_gradients` traces the same glass without files.
"""

import math
from pathlib import Path
from typing import NamedTuple

import pytest

import lfmesh as lf
from lfmesh.imports import read_lens_file
from tests.imports.files import GRADIENT_FILES
from tests.validation.stored_images import Sample, largest_height, text_of

SINE = 0.2
"""Numerical aperture of the rods' objects."""

END = "TYPE STANDARD\n  CURV {curvature}\n  DISZ {distance}\n  DIAM {size}\n  FLAP 0 {size} 0"


class Case(NamedTuple):
    """Sample, tolerance, and radius of the stop."""

    sample: Sample
    same_mm: float
    stop_mm: float
    gradient_at: int = 0
    """Number of the surface in front of the gradient."""


def rod(glass: str, length: float, size: float, distance: float, waves: list[float], stored_mm: float) -> Case:
    """Return a rod that images a point on its axis."""
    pupil = distance * SINE / math.sqrt(1.0 - SINE * SINE)
    text = text_of(
        f"OBNA {SINE} 0", waves, repr(distance),
        f"STOP\n  {glass}\n  DISZ {length}\n  DIAM {size}\n  FLAP 0 {size} 0",
        END.format(curvature=0.0, distance=distance, size=size),
    )  # fmt: skip
    return Case(Sample(text, distance, stored_mm, pupil, 0.0, distance, ((0.0, 0.0),)), 1e-8, size)


INTERCONNECT = "TYPE GRINSUR1\n  PARM 1 0.1\n  PARM 2 1.5\n  PARM 3 -8.3e-2\n  PARM 4 0"
SELFOC = "TYPE GRINSUR9\n  PARM 1 0.1\n  PARM 2 0\n  PARM 3 0\n  GLAS SLS-1.0 0 0 1.5 40"
GRADIUM = "TYPE GRINSUR8\n  CURV -4.805916862489e-2\n  PARM 0 12.1\n  PARM 1 0.25\n  PARM 2 5\n  PARM 3 1.710571457024"
CASES = {
    "GRIN interconnect": rod(INTERCONNECT, 4.0, 1.0, 2.5406992524, [0.55], 2.491944691397e-2),
    "Selfoc lens": rod(SELFOC, 3.8, 0.5, 0.87204864785, [0.5, 0.55, 0.6], 2.449239901782e-2),
    "sc_grin3": Case(
        Sample(
            text_of(
                25.0, [0.4861327, 0.5875618, 0.6562725], "INFINITY",
                "STOP\n  TYPE STANDARD\n  CURV 3.8887055900509997e-2\n  DISZ 12.00002775736\n  DIAM 14\n  GLAS BK7",
                GRADIUM + "\n  GLAS G41SFN\n  DISZ 6.86911924985\n  DIAM 14\n  FLAP 0 14 0",
                END.format(curvature=-2.6110467750182106e-2, distance=29.05899462685, size=14),
            ),
            29.05899462685, 2.618121161292, 12.5, 0.0, math.inf, ((0.0, 0.0), (0.0, 4.0)),
        ),
        1e-6, 13.0, 1,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
@pytest.mark.filterwarnings("ignore::lfmesh.errors.LensFileWarning")
def test_the_image_is_as_large_as_opticstudio_stores_it(name: str, tmp_path: Path) -> None:
    sample, same_mm, stop_mm, number = CASES[name]
    for file, text in GRADIENT_FILES.items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    (tmp_path / "lens.zmx").write_text(sample.text, encoding="utf-8")
    lens, report = read_lens_file(tmp_path / "lens.zmx")
    assert lens.surfaces[number].gradient is not None
    assert report.conditions is not None
    assert report.conditions.image_mm == sample.image_mm
    # A stop that every ray passes, as the program does not aim at it.
    lens = lens.model_copy(update={"stop_semi_diameter_mm": stop_mm})
    sensor = {"pixels": (1000, 1000), "pixel_mm": 0.05, "distance_mm": sample.image_mm}
    world = lf.build(lf.Scene(camera={"lens": lens, "sensor": sensor}), aimed=False)
    heights = [largest_height(world, sample, nm) for nm in report.conditions.wavelengths_nm]
    assert max(heights) == pytest.approx(sample.stored_mm, rel=0.0, abs=same_mm)
