"""Gradient-index glass written to Zemax files and read again; what other files and types cannot hold is refused."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.imports.conditions import Conditions
from tests.imports.test_zemax_gradients import index_of

KINDS = {
    "radial_n2": "GRINSUR2", "radial_n": "GRINSUR3", "radial and deep": "GRINSUR5", "axial": "GRINSUR3",
    "spherical": "GRINSUR7", "flat spheres": "GRINSUR3", "xyz": "GRINSUR4",
}  # fmt: skip


def gradient(draw: np.random.Generator, kind: str) -> dict[str, Any]:
    """Return a random gradient that the type of Zemax can hold."""

    def terms(count: int) -> list[float]:
        return (0.02 * draw.normal(size=count) / 8.0 ** np.arange(count)).tolist()

    index = float(draw.uniform(1.4, 1.8))
    if kind == "radial_n2":
        return {"kind": kind, "index": index, "coefficients": terms(6)}
    if kind == "radial_n":
        return {"kind": kind, "index": index, "coefficients": terms(3), "axial_coefficients": terms(2)}
    if kind == "radial and deep":
        return {"kind": "radial_n", "index": index, "coefficients": terms(1), "axial_coefficients": terms(4)}
    if kind == "axial":
        return {"kind": kind, "index": index, "coefficients": terms(3)}
    if kind == "xyz":
        return {"kind": kind, "index": index} | {f"{axis}_coefficients": terms(2) for axis in "xyz"}
    radius = math.inf if kind == "flat spheres" else float(draw.choice([-30.0, 45.0]))
    return {"kind": "spherical", "index": index, "coefficients": terms(2), "radius_mm": radius}


def lens_with(keys: dict[str, Any], **front: Any) -> lf.Lens:
    """Return a lens of one element of gradient glass."""
    face = {"radius_mm": 40.0, "conic": -0.4, "thickness_mm": 3.0, "semi_diameter_mm": 2.0, "stop": True}
    back = {"radius_mm": -60.0, "semi_diameter_mm": 2.0}
    return lf.Lens(surfaces=(face | {"gradient": keys} | front, back))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_random_gradients_come_back(seed: int, kind: str, tmp_path: Path) -> None:
    lens = lens_with(gradient(np.random.default_rng([seed, list(KINDS).index(kind)]), kind))
    path = tmp_path / "lens.zmx"
    write_lens_file(lens, path, Conditions((550.0,), image_mm=60.0))
    assert f"TYPE {KINDS[kind]}" in path.read_text("utf-16")
    again, report = read_lens_file(path)
    assert report.conditions is not None
    assert report.conditions.image_mm == 60.0
    for one, other in zip(lens.surfaces, again.surfaces, strict=True):
        assert (other.radius_mm, other.conic, other.thickness_mm) == (one.radius_mm, one.conic, one.thickness_mm)
    points = np.random.default_rng(0).uniform([-2.0, -2.0, 0.0], [2.0, 2.0, 3.0], (30, 3))
    before, after = (index_of(each.surfaces[0].gradient, points) for each in (lens, again))
    np.testing.assert_allclose(after, before, rtol=1e-14)


SERIES = {"kind": "axial", "index": 1.6, "coefficients": [0.01] * 5}
DISPERSION = {"reference_nm": 587.6, "strengths": [[0.1]], "resonances_um2": [[0.01]]}
SELFOC = {"kind": "selfoc", "index": [1.55, 6e-3], "gradient_constant_per_mm": [0.3, 7e-3, 4e-4]}
GRADIUM = {"kind": "gradium", "coefficients": [1.7, -0.1], "blank_mm": 12.0}


@pytest.mark.parametrize(
    ("ending", "keys", "front", "said"),
    [
        (".seq", SELFOC, {}, "surfaces[0].gradient: not written to CODE V files; write .zmx"),
        (".zmx", SELFOC, {}, "gradient: not written to Zemax files: its numbers stand in a file of OpticStudio, GRAD"),
        (".zmx", GRADIUM, {}, "its numbers stand in a file of OpticStudio, PROFILE.GRD; write .toml"),
        (".zmx", SERIES | {"dispersion": DISPERSION}, {}, "surfaces[0].gradient.dispersion: not written to Zemax"),
        (".zmx", SERIES, {}, "Zemax's gradients have 3 powers of r² and 3 of z or 2 powers of r² and 4 of z"),
        (".zmx", {"kind": "radial_n2", "index": 1.6, "coefficients": [1e-3] * 7}, {}, "has 6 of its 7 coefficients"),
        (
            ".zmx", {"kind": "spherical", "index": 1.6, "coefficients": [1e-3] * 3, "radius_mm": 9.0}, {},
            "Zemax's gradient has 2 of its 3 coefficients",
        ),
        (".zmx", {"kind": "xyz", "index": 1.6, "y_coefficients": [0.0, 0.0, 1e-3]}, {}, "has 2 of its 3 coefficients"),
        (".zmx", SERIES, {"asphere_mm": [1e-6]}, "Zemax's surfaces with a gradient are spheres or conics"),
        (".zmx", SERIES, {"biconic": {"radius_x_mm": 30.0}}, "Zemax's surfaces with a gradient are spheres or conics"),
    ],
)  # fmt: skip
def test_a_gradient_that_a_file_cannot_hold_is_refused_in_one_line(ending, keys, front, said, tmp_path):
    path = tmp_path / f"lens{ending}"
    with pytest.raises(SceneError) as raised:
        write_lens_file(lens_with(keys, **front), path, Conditions(image_mm=50.0))
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not path.exists()
