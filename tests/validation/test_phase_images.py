"""Pictures through phase surfaces: where orders fall, how bright they are, and that both methods show the same.

Places come from a sequential trace through the exact surfaces that shares no code with the engine, one order at a time.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import qmc

import lfmesh as lf
from lfmesh.accuracy import analytic
from lfmesh.assets import asset_path
from tests.cameras import SQUARE_ARRAY, biconvex, close_up_camera
from tests.instances import instances
from tests.renders import by_seed, unchecked
from tests.validation.test_forward_equals_adjoint import LEVEL, REPLICATES, p_values, replicates
from tests.validation.test_phase_surfaces import in_one_medium

Array = NDArray[np.float64]
Tables = dict[str, Any]

NM = 587.6

# The light of all orders


def test_orders_and_the_ledger_account_for_all_light() -> None:
    """Two orders leave with their shares; one is evanescent, and 15 % of the light is in no listed order."""
    orders = [{"order": -1, "share": 0.2}, {"order": 0, "share": 0.3}, {"order": 1, "share": 0.35}]
    grating = {"kind": "grating", "lines_per_mm": 0.7 / (NM * 1e-6), "orders": orders}
    sine = 1.0 / 1.5
    d = np.array([[sine, 0.0, np.sqrt(1.0 - sine**2)]])
    paths = lf.trace(lf.build(in_one_medium(grating)), -d, d, weight_cutoff=0.0)
    there = np.isin(paths.body, ["sensor", "beside the sensor"])
    by_sine = np.argsort(paths.direction[there][:, 0])
    np.testing.assert_allclose(1.5 * paths.direction[there][by_sine, 0], [0.3, 1.0], atol=1e-12)
    np.testing.assert_allclose(paths.weight[there][by_sine], [0.2, 0.3], atol=1e-12)
    parts = {name: value for name, value in paths.ledger.absorbed.items() if value and name != "beside the sensor"}
    assert sorted(parts.values()) == pytest.approx([0.15, 0.35], abs=1e-12), parts
    assert abs(paths.ledger.imbalance) < 1e-12


def test_orders_of_a_plate_and_its_reflections_account_for_all_light() -> None:
    """With light that goes to and fro in the plate and meets the grating from both sides, also in reflection."""
    orders = [{"order": -1, "share": 0.1}, {"order": 0, "share": 0.25}, {"order": 1, "share": 0.5}]
    back = [{"order": 0, "share": 0.6}, {"order": -1, "share": 0.3}]
    grating = {"kind": "grating", "lines_per_mm": 400.0, "orders": orders, "reflected_orders": back}
    surfaces = [
        {"thickness_mm": 1.0, "index": 1.7, "semi_diameter_mm": 5.0, "stop": True},
        {"semi_diameter_mm": 5.0, "phase": grating},
    ]
    sensor = {"pixels": (40, 40), "pixel_mm": 1.0, "distance_mm": 2.0}
    world = lf.build(lf.Scene(camera={"lens": {"surfaces": surfaces}, "sensor": sensor}))
    draw = np.random.default_rng(2)
    d = np.column_stack([draw.uniform(-1.5, 1.5, (40, 2)), np.ones(40)])
    paths = lf.trace(world, -0.5 * d, d, weight_cutoff=0.0, max_events=8)
    assert abs(paths.ledger.imbalance) < 1e-12
    assert paths.ledger.sensor > 0.0
    assert not paths.ledger.lost_share
    ended = sum(paths.ledger.absorbed.values()) + paths.ledger.escaped + paths.ledger.depth + paths.ledger.sensor
    assert ended == pytest.approx(40.0, rel=1e-12)


def test_a_pixel_sees_the_light_that_passes_before_it_is_turned() -> None:
    """Light at a sine of 0.9 is turned into the axis: both faces pass 0.886 of it, not the 0.96 of light on the axis.

    Two sheets of one radiance: the plate without its grating shows the one on the axis, the plate with it the other.
    """
    step = 0.9
    grating = {"kind": "grating", "lines_per_mm": step / (NM * 1e-6)}
    angle = np.rad2deg(np.arcsin(step))
    glow = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}
    shape = {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}
    surfaces = [
        {"thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 9.0},
        {"thickness_mm": 1.0, "semi_diameter_mm": 9.0, "phase": grating},
        {"paraxial": True, "focal_length_mm": 20.0, "stop": True, "semi_diameter_mm": 1.0},
    ]
    scene = lf.Scene(
        camera={
            "lens": {"surfaces": surfaces},
            "sensor": {"pixels": (4, 4), "pixel_mm": 0.01, "distance_mm": 20.0},
        },
        targets=[
            {"shape": shape, "position_mm": [0.0, 0.0, -100.0], "material": glow},
            {
                "shape": shape, "position_mm": [100.0 * step, 0.0, -100.0 * np.sqrt(1.0 - step**2)],
                "rotation_deg": [0.0, -angle, 0.0], "material": glow,
            },
        ],
        transport={"split": "transmit", "samples": 512, "threads": 1},
    )  # fmt: skip
    cos_i, cos_t = np.sqrt(1.0 - step**2), np.sqrt(1.0 - (step / 1.5) ** 2)
    r_s, r_p = ((a - b) / (a + b) for a, b in ((cos_i, 1.5 * cos_t), (1.5 * cos_i, cos_t)))
    passed = (1.0 - 0.5 * (r_s**2 + r_p**2)) / 0.96
    assert 0.96 * passed == pytest.approx(0.886, abs=5e-4)
    plain = scene.changed({"camera.lens.surfaces[1].phase": None})
    for settings in ({"engine": "mesh"}, {"engine": "auto"}):
        bright, dim = (
            unchecked(each.changed({f"transport.{key}": value for key, value in settings.items()}))
            for each in (plain, scene)
        )
        ratio = dim.mean.sum() / bright.mean.sum()
        error = ratio * np.hypot(*(np.sqrt((i.stderr**2).sum()) / i.mean.sum() for i in (bright, dim)))
        assert error < 1e-3
        assert abs(ratio - passed**2) < 4.0 * error + 1e-4


# Places of the orders

SHARES = {-1: 0.3, 0: 0.2, 1: 0.4}


def before_an_array() -> lf.Scene:
    """Return a camera of f/7 whose lens is followed by a grating and an array, before a small disk that shines."""
    listed = [{"order": order, "share": share} for order, share in SHARES.items()]
    grating = {"kind": "grating", "lines_per_mm": 270.0, "direction_deg": 4.0, "orders": listed}
    surfaces = [
        {"paraxial": True, "focal_length_mm": 20.0, "thickness_mm": 2.0, "semi_diameter_mm": 1.5, "stop": True},
        {"thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 6.0},
        {"semi_diameter_mm": 6.0, "phase": grating},
    ]
    disk = {"shape": {"kind": "disk", "radius_mm": 1.0}, "position_mm": [0.0, 0.0, -200.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    return lf.Scene(
        camera={
            "focus_mm": 200.0, "lens": {"surfaces": surfaces}, "mla": SQUARE_ARRAY | {"count": [25, 7]},
            "sensor": {"pixels": [250, 70], "pixel_mm": 0.05},
        },
        targets=[disk],
        transport={"split": "transmit", "threads": 1, "samples": 64, "replicates": 1},
    )  # fmt: skip


def from_the_disk(count: int) -> tuple[Array, Array, Array]:
    """Return rays from the disk through the stop, and their light; evenly spread over both."""
    u = qmc.Sobol(4, seed=1).random(count)
    radius = np.sqrt(u[:, [0, 2]]) * [1.0, 1.5]
    phi = 2.0 * np.pi * u[:, [1, 3]]
    x, y = radius * np.cos(phi), radius * np.sin(phi)
    origins = np.column_stack([x[:, 0], y[:, 0], np.full(count, -200.0)])
    d = np.column_stack([x[:, 1], y[:, 1], np.zeros(count)]) - origins
    return origins, d, (d[:, 2] / np.linalg.norm(d, axis=1)) ** 4


def true_pictures(scene: lf.Scene) -> dict[int, Array]:
    """Return the picture of each order alone, in units of the light through the stop."""
    origins, d, light = from_the_disk(1 << 17)
    (columns, rows), pixel = scene.camera.sensor.pixels, scene.camera.sensor.pixel_mm
    edges = [(np.arange(n + 1) - 0.5 * n) * pixel for n in (rows, columns)]
    pictures = {}
    for order, share in SHARES.items():
        alone = scene.changed(
            {
                "camera.lens.surfaces[2].phase.orders": [],
                "camera.lens.surfaces[2].phase.order": order,
            }
        )
        landed = analytic.Camera.of(alone, NM).land(origins, d)
        x, y = landed.position[landed.arrives].T
        weight = (share * light * landed.weight)[landed.arrives] / light.sum()
        pictures[order] = np.histogram2d(y, x, bins=edges, weights=weight)[0]
    return pictures


def centroid(picture: Array) -> Array:
    """Return column and row of the centre of light."""
    rows, columns = np.indices(picture.shape)
    return np.array([(columns * picture).sum(), (rows * picture).sum()]) / picture.sum()


def test_a_grating_before_an_array_shows_its_orders_in_their_places() -> None:
    """Centroids within three standard errors, below 0.03 pixels, and powers in proportion to the shares."""
    scene = before_an_array()
    true = true_pictures(scene)
    images = [image.mean[..., 0] for image in by_seed(scene.changed({"transport.method": "forward"}), range(100, 124))]
    total = sum(each.sum() for each in true.values())
    for picture in true.values():
        column, _ = centroid(picture)
        first = max(0, int(column) - 24)
        window = slice(first, first + 48)
        assert picture[:, window].sum() > 0.999 * picture.sum()
        parts = [image[:, window] for image in images]
        for found, expected, largest in (
            (np.array([centroid(part) for part in parts]), centroid(picture) - [first, 0], 0.03),
            (
                np.array([[part.sum() / image.sum()] for part, image in zip(parts, images, strict=True)]),
                picture.sum() / total, 0.01,
            ),
        ):  # fmt: skip
            error = found.std(axis=0, ddof=1) / np.sqrt(len(images))
            assert error.max() < largest
            assert (np.abs(found.mean(axis=0) - expected) < 3.0 * error + 1e-4).all(), (found.mean(axis=0), expected)


# Both methods

CAMERAS = 20
IN_SUITE = (0, 3)

PLACES = ("front", "back", "curved face", "flat face", "metalens array", "steep plate")


def random_phase(draw: np.random.Generator, radius: float, power: float, line: float) -> Tables:
    """Draw a phase for light of 587.6 nm.

    Parameters
    ----------
    draw : Generator
    radius : float
        Of the beam, mm.
    power : float
        Largest power, 1/mm.
    line : float
        Largest change of the sine by a grating.
    """
    order = int(draw.choice([-2, -1, 1, 2]))
    first = -draw.uniform(-1.0, 1.0) * power * np.pi * radius**2 / (order * NM * 1e-6)
    higher = first * draw.normal(size=3) * 0.2
    phase: Tables = {"kind": str(draw.choice(["radial", "xy", "grating"])), "order": order}
    if phase["kind"] == "radial":
        phase |= {"coefficients_rad": [first, *higher[:1]], "radius_mm": radius}
    elif phase["kind"] == "xy":
        terms = [[2, 0, first], [0, 2, first], [1, 1, higher[0]], [3, 0, higher[1]], [0, 1, higher[2]]]
        phase |= {"coefficients_rad": terms, "radius_mm": radius}
    else:
        lines = draw.uniform(0.3, 1.0) * line / (abs(order) * NM * 1e-6)
        phase |= {"lines_per_mm": lines, "direction_deg": draw.uniform(-180.0, 180.0)}
    if draw.random() < 0.4:
        other = int(draw.choice([n for n in (-1, 0, 1) if n != order]))
        del phase["order"]
        phase["orders"] = [{"order": order, "share": 0.6}, {"order": other, "share": 0.3}]
    elif draw.random() < 0.4:
        phase |= {"efficiency": "blaze", "design_nm": 550.0, "blaze_order": order, "levels": 8}
    return phase


def drawn(number: int) -> lf.Scene:
    """Draw a camera with a phase on one of its faces before a chart that shines."""
    draw = np.random.default_rng([5, number])
    camera, place = close_up_camera(), PLACES[number % len(PLACES)]
    camera["lens"] = biconvex()
    surfaces = camera["lens"]["surfaces"]
    middle = np.zeros(2)
    if place in ("front", "back"):
        surfaces[PLACES.index(place)]["phase"] = random_phase(draw, 5.0, 0.015, 0.03)
    elif place == "steep plate":
        # Light at sines of up to 0.9 is turned towards the axis.
        step, turn = draw.uniform(0.4, 0.85), draw.uniform(-180.0, 180.0)
        phase = {"kind": "grating", "lines_per_mm": step / (NM * 1e-6), "direction_deg": turn}
        surfaces[:0] = [
            {"thickness_mm": 1.0, "index": 1.6, "semi_diameter_mm": 8.0},
            {"thickness_mm": 0.5, "semi_diameter_mm": 8.0},
        ]
        surfaces[int(draw.integers(2))]["phase"] = phase
        middle = 60.0 * step / np.sqrt(1.0 - step**2) * np.array([np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))])
    elif place == "metalens array":
        del camera["mla"]["focal_length_mm"]
        camera["mla"]["curved_phase"] = {"kind": "metalens", "focal_length_mm": 2.6, "design_nm": 550.0}
        camera["mla"]["curved_side"] = str(draw.choice(["lens", "sensor"]))
    else:
        camera["mla"][place.replace(" face", "_phase")] = random_phase(draw, 0.25, 0.1, 0.05)
    wide = 9.0 if place != "steep plate" else 24.0
    chart = {
        "shape": {"kind": "plane", "width_mm": wide, "height_mm": wide}, "position_mm": [*middle.tolist(), -60.0],
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": "charts/chart.png"},
    }  # fmt: skip
    scene = lf.Scene(
        camera=camera, targets=[chart], transport={"split": str(draw.choice(["transmit", "both"])), "threads": 1}
    )
    return scene.in_folder(asset_path("."))


def compared(scene: lf.Scene, samples: tuple[int, int]) -> tuple[float, dict[str, float]]:
    """Return the relative error of the sums' difference, and the p-values of all comparisons of both methods."""
    adjoint, forward = (replicates(scene, *of) for of in zip(("adjoint", "forward"), samples, strict=True))
    sums = [images.sum(axis=(1, 2)) for images in (adjoint, forward)]
    error = np.hypot(*(each.std(ddof=1) / each.mean() for each in sums)) / np.sqrt(REPLICATES)
    return float(error), dict(p_values(adjoint, forward))


@pytest.mark.parametrize("number", instances(range(CAMERAS), long=[n for n in range(CAMERAS) if n not in IN_SUITE]))
def test_forward_equals_adjoint_through_random_phases(number: int) -> None:
    """Welch's t-tests of squares of pixels and of their sum, each camera at LEVEL (Bonferroni)."""
    error, found = compared(drawn(number), (32, 96) if number in IN_SUITE else (192, 576))
    assert 3.0 * error < (0.04 if number in IN_SUITE else 0.02)
    worst = min(found, key=lambda name: found[name])
    assert found[worst] > LEVEL / len(found), f"{worst}: {found[worst]:.2g}\n{drawn(number).dump_toml()}"


def kinds_of(tables: Any) -> Iterator[str]:
    """Yield the kinds of all phases in the tables of a scene."""
    if isinstance(tables, dict):
        for key, value in tables.items():
            if key.endswith("phase") and value:
                yield value["kind"]
            else:
                yield from kinds_of(value)
    elif isinstance(tables, list | tuple):
        for value in tables:
            yield from kinds_of(value)


def test_the_random_cameras_have_every_kind_of_phase() -> None:
    found = [list(kinds_of(drawn(number).model_dump())) for number in range(CAMERAS)]
    assert all(len(kinds) == 1 for kinds in found)
    assert {kind for kinds in found for kind in kinds} == {"radial", "xy", "grating", "metalens"}
