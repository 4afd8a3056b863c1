"""Pictures through gradient-index glass: radiance, the ledger, and that both methods show the same.

Along a ray L/n² is constant, in glass whose index changes from place to place as well as across a face.
"""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from tests.cameras import biconvex, close_up_camera
from tests.instances import instances
from tests.renders import unchecked
from tests.validation.test_forward_equals_adjoint import LEVEL
from tests.validation.test_phase_images import compared

Tables = dict[str, Any]

GLOW = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}


def behind_a_plate(glass: Tables, **transport: Any) -> lf.Scene:
    """Return a camera whose ideal lens looks through a plate of glass at a wide sheet that shines."""
    surfaces = [
        {"thickness_mm": 4.0, "semi_diameter_mm": 9.0, **glass},
        {"thickness_mm": 1.0, "semi_diameter_mm": 9.0},
        {"paraxial": True, "focal_length_mm": 20.0, "stop": True, "semi_diameter_mm": 1.0},
    ]
    sheet = {"shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}, "position_mm": [0.0, 0.0, -100.0],
             "material": GLOW}  # fmt: skip
    sensor = {"pixels": (4, 4), "pixel_mm": 0.01, "distance_mm": 20.0}
    settings = {"split": "transmit", "samples": 512, "threads": 1, **transport}
    return lf.Scene(camera={"lens": {"surfaces": surfaces}, "sensor": sensor}, targets=[sheet], transport=settings)


def test_radiance_over_the_square_of_the_index_stays_along_a_ray() -> None:
    """A plate of index 1.5 in front and 1.9 behind is as bright as its faces transmit: 0.96 × 0.904."""
    axial = {"gradient": {"kind": "axial", "index": 1.5, "coefficients": [0.1]}}
    bright, dim = (unchecked(behind_a_plate(glass, method="adjoint", samples=512)) for glass in ({"index": 1.5}, axial))
    ratio = dim.mean.sum() / bright.mean.sum()
    error = ratio * np.hypot(*(np.sqrt((i.stderr**2).sum()) / i.mean.sum() for i in (bright, dim)))
    assert error < 5e-3
    assert abs(ratio - (4.0 * 1.9 / 2.9**2) / 0.96) < 4.0 * error + 1e-4


# All light ends somewhere

ROD = {"kind": "radial_n2", "index": 1.6, "coefficients": [-0.09]}
PARTS: dict[str, Tables] = {
    "rod": ROD,
    "axial": {"kind": "axial", "index": 1.5, "coefficients": [0.04]},
    "diverging": {"kind": "radial_n", "index": 1.5, "coefficients": [0.02]},
    "spherical": {"kind": "spherical", "index": 1.6, "radius_mm": 12.0, "coefficients": [0.05]},
    "linear": {"kind": "xyz", "index": 1.6, "y_coefficients": [0.08]},
}


@pytest.mark.parametrize("name", PARTS)
def test_the_ledger_accounts_for_all_light_with_reflections(name: str) -> None:
    """Rays that turn round inside, meet the edge, or are reflected to and fro between curved faces, coated ones too."""
    surfaces = [
        {"radius_mm": 9.0, "thickness_mm": 7.0, "semi_diameter_mm": 2.0, "stop": True, "gradient": PARTS[name]},
        {"radius_mm": -14.0, "thickness_mm": 2.0, "semi_diameter_mm": 2.0, "index": 1.7, "coating": "mirror"},
        {"semi_diameter_mm": 2.5},
    ]
    sensor = {"pixels": (40, 40), "pixel_mm": 1.0, "distance_mm": 2.0}
    scene = lf.Scene(
        camera={"lens": {"surfaces": surfaces}, "sensor": sensor}, coatings={"mirror": {"reflectance": 0.5}}
    )
    draw = np.random.default_rng(2)
    d = np.column_stack([draw.uniform(-1.0, 1.0, (300, 2)), np.ones(300)])
    origins = np.column_stack([draw.uniform(-1.5, 1.5, (300, 2)), np.zeros(300)]) - 0.5 * d
    paths = lf.trace(lf.build(scene), origins, d, weight_cutoff=0.0, max_events=10)
    assert abs(paths.ledger.imbalance) < 1e-9
    assert not paths.ledger.lost_share
    ended = sum(paths.ledger.absorbed.values()) + paths.ledger.escaped + paths.ledger.depth + paths.ledger.sensor
    assert ended == pytest.approx(300.0, rel=1e-12)
    assert paths.ledger.sensor > 3.0


def test_a_ray_that_turns_back_leaves_by_the_face_that_it_entered() -> None:
    """In an index that falls along the axis, a steep ray turns round as above a hot road; blocks book it as turned."""
    falling = {"kind": "axial", "index": 1.8, "coefficients": [-0.1]}
    surfaces = [
        {"thickness_mm": 7.0, "semi_diameter_mm": 60.0, "stop": True, "gradient": falling},
        {"semi_diameter_mm": 60.0},
    ]
    sensor = {"pixels": (4, 4), "pixel_mm": 1.0, "distance_mm": 2.0}
    world = lf.build(
        lf.Scene(camera={"lens": {"surfaces": surfaces}, "sensor": sensor, "object_medium": {"index": 1.7}})
    )
    # n sin α is 1.3 and 1.05: the index behind is 1.1.
    sines = np.array([1.3, 1.05]) / 1.7
    d = np.column_stack([sines, np.zeros(2), np.sqrt(1.0 - sines**2)])
    paths = lf.trace(world, -0.1 * d, d, split="transmit")
    row = int(np.flatnonzero(paths.source == 0)[0])
    assert paths.status[row] == lf.Status.ESCAPED
    np.testing.assert_allclose(paths.direction[row], d[0] * [1.0, 1.0, -1.0], atol=1e-10)
    # n is 1.8 - z / 10, and n sin θ stays 1.3: a catenary.
    back = paths.position[row] - paths.position[row, 2] / paths.direction[row, 2] * paths.direction[row]
    np.testing.assert_allclose(back, [26.0 * np.arccosh(1.8 / 1.3), 0.0, 0.0], atol=1e-8)
    assert abs(paths.ledger.imbalance) < 1e-12
    blocks = lf.trace(world, -0.1 * d, d, split="transmit", engine="sequential").ledger
    turned = [value for name, value in blocks.absorbed.items() if value and "turn" in name]
    assert turned == [pytest.approx(1.0, rel=0.02)]
    assert abs(blocks.imbalance) < 1e-12


# Both methods

CAMERAS = 20
IN_SUITE = (0, 3)
PLACES = ("element", "cemented", "posed element", "plate of the array", "rods", "rods with clear walls")
KINDS = ("radial_n2", "radial_n", "axial", "spherical", "xyz")


def random_gradient(draw: np.random.Generator, kind: str, radius: float, length: float) -> Tables:
    """Draw a gradient that changes the index by up to 0.08 within a radius and a length, mm."""
    first, second = draw.uniform(0.3, 1.0) * draw.choice([-0.08, 0.08]), 0.01 * draw.normal()
    across, along = [first / radius**2, second / radius**4], [first / length, second / length**2]
    gradient: Tables = {"kind": kind, "index": draw.uniform(1.5, 1.7)}
    if kind == "xyz":
        return gradient | {"x_coefficients": [0.0, across[0]], "y_coefficients": [0.0, *across]}
    if kind == "spherical":
        gradient["radius_mm"] = float(draw.choice([-1.0, 1.0]) * draw.uniform(3.0, 8.0) * radius)
    return gradient | {"coefficients": across if kind.startswith("radial") else along}


def drawn(number: int) -> lf.Scene:
    """Draw a camera with gradient-index glass in one place before a chart that shines."""
    draw = np.random.default_rng([8, number])
    camera, place = close_up_camera(), PLACES[number % len(PLACES)]
    kind = KINDS[number // len(PLACES) % len(KINDS)]
    camera["lens"] = biconvex()
    surfaces, mla = camera["lens"]["surfaces"], camera["mla"]
    if place in ("element", "posed element", "cemented"):
        front = surfaces[0]
        if place == "cemented":
            surfaces.insert(1, {"radius_mm": -30.0, "thickness_mm": 2.0, "index": 1.6, "semi_diameter_mm": 5.0})
        elif place == "posed element":
            pose = {"tilt_deg": [*draw.uniform(-3.0, 3.0, 2), 40.0], "shift_mm": [*draw.uniform(-0.2, 0.2, 2), 0.0]}
            camera["lens"]["elements"] = [{"surfaces": [0, 1], "pose": pose}]
        del front["index"]
        front["gradient"] = random_gradient(draw, kind, 5.0, 3.0)
    else:
        del mla["focal_length_mm"], mla["index"]
        if place == "plate of the array":
            mla["radius_mm"] = 1.3
            mla["gradient"] = random_gradient(draw, "radial_n2", 0.7, 0.5)
        else:
            # g L is about 0.6, and the focal length 2.8 mm.
            mla |= {
                "gradient": {"kind": "radial_n2", "index": 1.6, "coefficients": [-draw.uniform(0.1, 0.2)]},
                "thickness_mm": 1.6,
            }
            mla["walls"] = "clear" if place.endswith("walls") else "absorb"
    chart = {
        "shape": {"kind": "plane", "width_mm": 9.0, "height_mm": 9.0}, "position_mm": [0.0, 0.0, -60.0],
        "material": GLOW | {"texture": "charts/chart.png"},
    }  # fmt: skip
    scene = lf.Scene(
        camera=camera, targets=[chart], transport={"split": str(draw.choice(["transmit", "both"])), "threads": 1}
    )
    return scene.in_folder(asset_path("."))


@pytest.mark.parametrize("number", instances(range(CAMERAS), long=[n for n in range(CAMERAS) if n not in IN_SUITE]))
def test_forward_equals_adjoint_through_random_gradients(number: int) -> None:
    """Welch's t-tests of squares of pixels and of their sum, each camera at LEVEL (Bonferroni)."""
    error, found = compared(drawn(number), (32, 96) if number in IN_SUITE else (192, 576))
    assert 3.0 * error < (0.04 if number in IN_SUITE else 0.02)
    worst = min(found, key=lambda name: found[name])
    assert found[worst] > LEVEL / len(found), f"{worst}: {found[worst]:.2g}\n{drawn(number).dump_toml()}"


def test_the_random_cameras_have_every_kind_of_gradient_and_every_place() -> None:
    gradients = [[gradient for _, gradient, _ in drawn(number).gradients()] for number in range(CAMERAS)]
    assert all(len(each) == 1 for each in gradients)
    assert {gradient.kind for ((gradient),) in gradients} >= {"radial_n2", "radial_n", "axial", "spherical"}
