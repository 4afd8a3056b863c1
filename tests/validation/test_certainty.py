"""Errors and bounds of single pixels hold as often as they promise, by tenths of brightness, whatever brings the light.

The truth of a tiny picture is the mean over independent seeds with many more samples. The pixels of a tenth are those
that the truth puts there, which no noise of an image decides.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from tests.cameras import biconvex, close_up_camera
from tests.renders import by_seed

Array = NDArray[Any]

SIDE = 12
"""Pixels of a picture's side."""

SEEDS = 24
REPLICATES = 8
SAMPLES = 64

UPPER, WITHIN, NOT_MORE = 0.93, 0.92, 0.98
"""Least share of the pixels of a tenth below `upper`, and within Student's 95 % of `error`; most of all that have found
light by more than `MANY` samples."""

MANY = 30

LEVEL = 1e-3 / 30
"""Of each comparison, so that all of a scene fail by chance once in a thousand times."""

CAMERA = close_up_camera(SIDE, SIDE)
WITHOUT_ARRAY = {key: part for key, part in CAMERA.items() if key != "mla"} | {
    "sensor": {"pixels": [SIDE, SIDE], "pixel_mm": 0.2}
}
STOPPED_DOWN = {"surfaces": [*biconvex()["surfaces"][:2], {"stop": True, "semi_diameter_mm": 1.0}]}
LAMP = {"kind": "point", "position_mm": [20.0, -15.0, -25.0], "power_w": 1.0}
FOG = {"scattering_per_mm": 0.01, "absorption_per_mm": 0.001, "phase": {"kind": "henyey_greenstein", "g": 0.8}}


def plane(z: float = -60.0, x: float = 0.0, size: float = 8.0, **material: Any) -> dict[str, Any]:
    return {"shape": {"kind": "plane", "width_mm": size, "height_mm": size}, "position_mm": [x, 0.0, z],
            "material": material}  # fmt: skip


def glass(file: str, *position_mm: float) -> dict[str, Any]:
    return {"refractor": {"file": file, "units": "mm", "index": 1.5}, "position_mm": list(position_mm)}


KINDS: dict[str, dict[str, Any]] = {
    # The ball stands beside the field, and throws its caustic into it.
    "caustic": {"targets": [plane(reflectance=0.8), glass("ball.stl", 5.4, -4.05, -51.0)], "lights": [LAMP]},
    "caustic among strays": {
        "camera": CAMERA,
        "targets": [plane(reflectance=0.8), glass("ball.stl", 2.0, -1.5, -57.0)],
        "lights": [LAMP],
        "transport": {"split": "both"},
    },
    "gloss": {
        "targets": [
            plane(reflectance=0.5, gloss={"index": 1.5, "roughness": 0.1}),
            plane(-58.0, 4.0, 3.0, reflectance=0.0, radiance_w_m2_sr=50.0) | {"rotation_deg": [0.0, 60.0, 0.0]},
        ],
        "lights": [LAMP],
    },
    "fog": {"targets": [plane(reflectance=0.8)], "lights": [LAMP], "media": [FOG]},
    # What shines stands beside the field; before a dim board it brings most light, by two reflections.
    "ghosts": {
        "camera": WITHOUT_ARRAY | {"lens": STOPPED_DOWN},
        "targets": [
            plane(reflectance=0.0, radiance_w_m2_sr=1e-3),
            plane(-59.0, 6.0, 6.0, reflectance=0.0, radiance_w_m2_sr=100.0),
        ],
        "transport": {"split": "both"},
    },
    "lamp through glass": {
        "targets": [plane(reflectance=0.8), glass("plate.stl", 0.0, 0.0, -57.0)],
        "lights": [LAMP],
    },
    "forward": {"targets": [plane(reflectance=0.8)], "lights": [LAMP], "transport": {"method": "forward"}},
}


MOSTLY_UNMET = {"ghosts"}
"""Kinds whose light most pixels have not met, and are alike in that: what bounds it in 93 % of them does in all."""


@pytest.fixture(scope="module")
def scene_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], lf.Scene]:
    """Return the scene of a kind."""
    folder: Path = tmp_path_factory.mktemp("glass")
    trimesh.creation.icosphere(3, 1.0).export(folder / "ball.stl")
    trimesh.creation.box((6.0, 6.0, 2.0)).export(folder / "plate.stl")

    def scene(kind: str) -> lf.Scene:
        tables = {"camera": WITHOUT_ARRAY} | KINDS[kind]
        transport = {"split": "transmit", "samples": SAMPLES, "replicates": REPLICATES, "threads": 1}
        return lf.Scene(**tables | {"transport": transport | KINDS[kind].get("transport", {})}).in_folder(folder)

    return scene


@dataclass(frozen=True)
class Held:
    """What held in the images of some seeds, each (seeds, pixels).

    Attributes
    ----------
    upper, within : bool
        The truth is at most `upper`; it is within Student's 95 % of `error`.
    tenth : (pixels,) int64
        Tenth of brightness.
    many : (pixels,) bool
        More than `MANY` samples bring light on average.
    """

    upper: Array
    within: Array
    tenth: Array
    many: Array

    def report(self) -> str:
        """Return the shares by tenths, in per cent."""
        rows = [f"{100.0 * np.array([of[:, self.tenth == k].mean() for k in range(10)]).round(3)}"
                for of in (self.upper, self.within)]  # fmt: skip
        most = [
            f"{100.0 * of[:, self.many].mean():.1f}" if self.many.any() else "-" for of in (self.upper, self.within)
        ]
        return f"upper {rows[0]}, with many hits {most[0]}\nwithin {rows[1]}, with many hits {most[1]}"

    def is_less(self, of: Array, than: float, tenth: int) -> bool:
        """Tell whether a share surely is less in a tenth."""
        here = of[:, self.tenth == tenth]
        return bool(stats.binomtest(int(here.sum()), here.size, than, "less").pvalue < LEVEL)

    def is_more(self, of: Array, than: float) -> bool:
        """Tell whether a share of the pixels with many hits surely is more."""
        here = of[:, self.many]
        return bool(here.size and stats.binomtest(int(here.sum()), here.size, than, "greater").pvalue < LEVEL)


def held(scene: lf.Scene, seeds: int, for_truth: int, times: int) -> Held:
    """Compare images with the truth: the mean over `for_truth` seeds with `times` as many samples."""
    more = scene.changed({"transport.samples": SAMPLES * times})
    longer = np.array([image.mean.ravel() for image in by_seed(more, range(1000, 1000 + for_truth))])
    truth, unsure = longer.mean(axis=0), longer.var(axis=0, ddof=1) / for_truth
    quantile = stats.t.ppf(0.975, REPLICATES - 1)
    upper, within, hits = [], [], []
    for image in by_seed(scene, range(seeds)):
        upper.append(image.upper.ravel() >= truth)
        off = abs(image.mean.ravel() - truth)
        within.append(off <= quantile * np.sqrt(image.error.ravel() ** 2 + unsure))
        assert image.hits is not None
        hits.append(image.hits.ravel())
    tenth = truth.argsort().argsort() * 10 // truth.size
    return Held(np.array(upper), np.array(within), tenth, np.mean(hits, axis=0) > MANY)


def test_bounds_and_errors_hold_ghosts_that_a_pixel_has_not_met(scene_of: Callable[[str], lf.Scene]) -> None:
    """Nearly all samples find the board; of eight that look for ghosts hardly any finds one."""
    found = held(scene_of("ghosts"), 8, 6, 16)
    for tenth in range(10):
        assert not found.is_less(found.upper, UPPER, tenth), found.report()
        assert not found.is_less(found.within, WITHIN, tenth), found.report()


BALL_OVER_BOARD: dict[str, Any] = {
    "camera": {
        "focus_mm": 2239.8,
        "lens": {"surfaces": [{"stop": True, "paraxial": True, "focal_length_mm": 46.026}], "f_number": 2.0272},
        "mla": {"layout": "hexagonal", "count": [5, 7], "pitch_mm": 0.19385, "radius_mm": 0.28242, "index": 1.7768,
                "thickness_mm": 0.17759},
        "sensor": {"pixels": [9, 14], "pixel_mm": 0.027705, "distance_mm": 0.44744},
    },
    "targets": [
        plane(-2239.8, size=31.0, reflectance=0.7),
        {"shape": {"kind": "sphere", "radius_mm": 2.2}, "position_mm": [-4.9, -3.3, -1893.6],
         "material": {"reflectance": 0.9, "radiance_w_m2_sr": 1.5}},
    ],
}  # fmt: skip
"""A ball of which some pixels see a little through the rims of lenslets' views, 10⁴ times as bright as a board."""


def test_bounds_hold_light_through_rims_of_views_that_a_pixel_has_not_met_and_a_warning_says_so() -> None:
    """A quarter of the samples of each pixel meet the board; of 768 hardly any meets the ball from the dim ones."""
    scene = lf.Scene(**BALL_OVER_BOARD).changed(
        {"transport": {"split": "transmit", "samples": 768, "replicates": REPLICATES, "threads": 1}}
    )
    truth = lf.render(scene.changed({"transport.method": "forward", "transport.samples": 8192})).mean
    dim = truth < np.quantile(truth, 0.2)
    held_ = []
    for image in by_seed(scene, range(6)):
        assert any("those of their neighbours" in str(said) for said in image.warnings), image.warnings
        held_.append(image.upper[dim] >= truth[dim])
    found = np.array(held_)
    assert stats.binomtest(int(found.sum()), found.size, UPPER, "less").pvalue > LEVEL, found.mean()


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_errors_and_bounds_hold_as_often_as_they_promise(kind: str, scene_of: Callable[[str], lf.Scene]) -> None:
    found = held(scene_of(kind), SEEDS, 16, 16)
    print(f"{kind}\n{found.report()}")
    for tenth in range(10):
        assert not found.is_less(found.upper, UPPER, tenth), found.report()
        assert not found.is_less(found.within, WITHIN, tenth), found.report()
    if kind not in MOSTLY_UNMET:
        assert not found.is_more(found.upper, NOT_MORE), found.report()
        assert not found.is_more(found.within, NOT_MORE), found.report()
