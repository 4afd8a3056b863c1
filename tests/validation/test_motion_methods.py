"""Both methods show the same of random scenes that move; the ledger closes; errors are those stated; threads."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as Picture
from scipy import stats

import lfmesh as lf
from tests.cameras import close_up_camera
from tests.instances import instances
from tests.renders import by_seed, unchecked
from tests.validation.motion_scenes import DURATION_S, Tables
from tests.validation.test_forward_equals_adjoint import LEVEL, plane, squares
from tests.validation.test_phase_images import compared

MOTIONS = 30
IN_SUITE = (4, 7, 14, 17, 21, 24)

MOVERS = ("target", "light", "camera", "fog", "glass", "tank")
LIGHTS = ("glow", "point", "disk", "spot", "glowing fog")

GLOWING: Tables = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": "chart.png"}
PAINTED: Tables = {"reflectance": 0.8, "texture": "chart.png"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a coarse chart that looks like none of its mirror images."""
    there = tmp_path_factory.mktemp("motions")
    levels = np.random.default_rng(5).integers(90, 256, (5, 6)).astype(np.uint8)
    levels[0, 0], levels[-1, 1] = 0, 255
    Picture.fromarray(levels).save(there / "chart.png")
    return there


def kinds_of(number: int) -> tuple[str, str]:
    """Return what moves in a scene, and what gives its light."""
    return MOVERS[number % len(MOVERS)], LIGHTS[number // len(MOVERS)]


def motion(draw: np.random.Generator, path_mm: float, turn_deg: float) -> Tables:
    """Draw a motion of up to a path and a turn in the exposure."""
    velocity, spin = (
        limit / DURATION_S * draw.uniform(0.3, 1.0) * draw.normal(size=3) / np.sqrt(3.0)
        for limit in (path_mm, turn_deg)
    )
    return {"motion": {"velocity_mm_s": velocity.tolist(), "spin_deg_s": spin.tolist()}}


def exposed(draw: np.random.Generator) -> Tables:
    """Draw an exposure: half of them with a shutter, half of them rolling."""
    keys: Tables = {"duration_s": 0.5 * DURATION_S if draw.uniform() < 0.5 else DURATION_S}
    if draw.uniform() < 0.5:
        times = keys["duration_s"] * np.array([0.0, *np.sort(draw.uniform(0.1, 0.9, 2)), 1.0])
        opening = [draw.choice([0.0, 0.5]), 1.0, draw.uniform(0.2, 1.0), draw.choice([0.0, 1.0])]
        keys["shutter"] = np.column_stack([times, opening]).tolist()
    if keys["duration_s"] < DURATION_S:
        keys |= {"row_time_s": 0.025 * DURATION_S, "row_direction": str(draw.choice(["down", "up"]))}
    return keys


def lamp_of(kind: str, draw: np.random.Generator) -> Tables:
    """Draw a lamp beside the camera's view."""
    at = np.array([16.0, -12.0, -30.0]) + draw.uniform(-3.0, 3.0, 3)
    keys: Tables = {"kind": kind, "position_mm": at.tolist(), "power_w": 1.0}
    if kind != "point":
        keys["direction"] = (np.array([0.0, 0.0, -60.0]) - at).tolist()
    return keys | {"point": {}, "disk": {"radius_mm": 3.0}, "spot": {"half_angle_deg": 15.0, "edge_deg": 6.0}}[kind]


def drawn(number: int, folder: Path) -> lf.Scene:
    """Draw a scene in which one kind of thing moves, lit by one kind of light."""
    draw = np.random.default_rng([11, number])
    mover, light = kinds_of(number)
    glows = light == "glow"
    chart = plane(GLOWING if glows else PAINTED)
    box: Tables = {
        "shape": {"kind": "box", "size_mm": (1.5, 1.2, 1.0)}, "position_mm": (0.8, -0.6, -57.0),
        "rotation_deg": draw.uniform(-40.0, 40.0, 3).tolist(), "material": {"reflectance": 0.5},
    }  # fmt: skip
    fog: Tables = {
        "bounds": {"kind": "sphere", "radius_mm": 3.0}, "position_mm": (0.0, 0.3, -50.0),
        "absorption_per_mm": 0.03, "scattering_per_mm": 0.03,
    }  # fmt: skip
    if light == "glowing fog":
        fog |= {"position_mm": (9.0, 0.3, -52.0), "emission_w_mm3_sr": 1e-6}
    lamp = None if light in ("glow", "glowing fog") else lamp_of(light, draw)
    tables: dict[str, Any] = {"camera": close_up_camera()}
    targets, media = [chart, box], []
    if mover == "fog" or light == "glowing fog":
        media = [fog]
    if mover == "target":
        box |= motion(draw, 2.0, 40.0)
    elif mover == "light":
        source: Tables = chart if glows else fog if lamp is None else lamp
        source |= motion(draw, 2.0 if lamp is None else 6.0, 10.0)
    elif mover == "camera":
        tables["camera"] |= motion(draw, 1.0, 1.5)
    elif mover == "fog":
        fog |= motion(draw, 3.0, 40.0)
    elif mover == "glass":
        glass: Tables = {
            "refractor": {"box_mm": (7.0, 6.0, 2.0), "index": 1.5}, "position_mm": (0.5, 0.3, -46.0),
            "rotation_deg": draw.uniform(-15.0, 15.0, 3).tolist(),
        }  # fmt: skip
        targets = [chart, glass | motion(draw, 1.5, 30.0)]
    else:
        shared = motion(draw, 1.0, 0.0)
        water: Tables = {
            "size_mm": (9.0, 8.0, 7.0), "wall_mm": 0.5, "wall": {"index": 1.5}, "liquid": {"index": 1.333},
            "position_mm": (0.3, 0.0, -50.0),
        }  # fmt: skip
        tables["tanks"] = [water | shared]
        targets = [chart, box | {"position_mm": (0.6, -0.5, -50.0)} | shared]
    return lf.Scene(
        targets=targets, media=media, lights=[] if lamp is None else [lamp], exposure=exposed(draw),
        transport={"split": "transmit", "threads": 1}, **tables,
    ).in_folder(folder)  # fmt: skip


def samples_of(number: int) -> tuple[int, int]:
    """Return samples of a pixel, adjoint and forward; light through glass comes from few packets."""
    if number in IN_SUITE:
        return 32, 96
    return (256, 1024) if kinds_of(number)[0] in ("glass", "tank") else (128, 384)


@pytest.mark.parametrize("number", instances(range(MOTIONS), long=[n for n in range(MOTIONS) if n not in IN_SUITE]))
def test_forward_equals_adjoint_in_random_motions(number: int, folder: Path) -> None:
    """Welch's t-tests of squares of pixels and of their sum, each scene at LEVEL (Bonferroni)."""
    scene = drawn(number, folder)
    error, p_values = compared(scene, samples_of(number))
    assert 3.0 * error < (0.1 if number in IN_SUITE else 0.05)
    worst = min(p_values, key=lambda name: p_values[name])
    assert p_values[worst] > LEVEL / len(p_values), f"{worst}: {p_values[worst]:.2g}\n{scene.dump_toml()}"


def test_the_random_motions_have_every_mover_and_every_light(folder: Path) -> None:
    assert len({kinds_of(number) for number in range(MOTIONS)}) == len(MOVERS) * len(LIGHTS)
    seen = [kinds_of(number) for number in IN_SUITE]
    assert {mover for mover, _ in seen} == set(MOVERS)
    assert {light for _, light in seen} == set(LIGHTS)
    scenes = [drawn(number, folder) for number in range(MOTIONS)]
    exposures = [scene.exposure for scene in scenes]
    assert all(scene.moves for scene in scenes)
    assert len({(bool(e.shutter), bool(e.row_time_s), e.row_direction) for e in exposures if e is not None}) == 6


@pytest.mark.parametrize("number", instances(range(len(MOVERS)), long=[0, 3, 5]))
def test_the_pictures_of_random_motions_differ_from_those_at_rest(number: int, folder: Path) -> None:
    """Else the test of both methods would see no motion: adjoint pictures of every mover."""
    moving = drawn(number, folder)
    pictures = [squares(stack_of(scene)) for scene in (moving, at_rest(moving))]
    assert stats.ttest_ind(*pictures, equal_var=False).pvalue.min() < 1e-9


def at_rest(scene: lf.Scene) -> lf.Scene:
    """Return a scene without its motions."""

    def without(table: Any) -> Any:
        if isinstance(table, dict):
            return {key: without(value) for key, value in table.items() if key not in ("motion", "exposure")}
        return [without(value) for value in table] if isinstance(table, list) else table

    tables = scene.model_dump(exclude_unset=True, mode="json")
    return scene.changed({"exposure": None, **{key: without(tables[key]) for key in PARTS if key in tables}})


PARTS = ("camera", "targets", "lights", "media", "tanks")


def stack_of(scene: lf.Scene) -> Any:
    """Return 16 adjoint pictures, (16, H, W)."""
    settings = {"transport.samples": 64, "transport.replicates": 1}
    return np.array([image.mean[..., 0] for image in by_seed(scene.changed(settings), range(16))])


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("number", IN_SUITE)
def test_the_ledger_accounts_for_all_light(number: int, method: str, folder: Path) -> None:
    """All reflections too; in the forward method, of light that falls on rows outside their windows."""
    scene = drawn(number, folder).changed(
        {"transport.samples": 16, "transport.method": method, "transport.split": "both", "transport.replicates": 2}
    )
    image = unchecked(scene)
    ledgers = [image.ledger, *([image.ledger.lamps] if image.ledger.lamps is not None else [])]
    assert image.mean.sum() > 0.0
    for ledger in ledgers:
        assert abs(ledger.imbalance) < 1e-12
        assert not ledger.lost_share
    if method == "forward":
        assert image.ledger.sensor == pytest.approx(image.mean.sum(), rel=1e-10)


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("number", [0, 14, 21])
def test_threads_do_not_change_a_picture(number: int, method: str, folder: Path) -> None:
    scene = drawn(number, folder).changed({"transport.samples": 16, "transport.method": method})
    one, two = (unchecked(scene.changed({"transport.threads": threads})).mean for threads in (1, 2))
    assert one.any()
    np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_replicates_tell_the_error(method: str, folder: Path) -> None:
    """The spread of the pixels over seeds is the standard error that pictures state."""
    scene = drawn(0, folder).changed({"transport.samples": 64, "transport.replicates": 8, "transport.method": method})
    images = list(by_seed(scene, range(40)))
    pixel = np.array([image.mean.ravel() for image in images])
    stated = np.array([image.stderr.ravel() ** 2 for image in images]).mean(axis=0)
    bright = np.argsort(pixel.mean(axis=0))[-200:]
    ratio = pixel[:, bright].var(axis=0, ddof=1) / stated[bright]
    # Variances of 40 seeds, and of 40 x 7 replicates.
    tail = stats.f.sf(ratio, len(images) - 1, 7 * len(images))
    assert min(tail.min(), (1.0 - tail).min()) > 0.5 * LEVEL / len(bright)
    # Pixels share no time: their sum has the error of independent ones, or less if they share packets.
    chi2 = (len(images) - 1) * pixel[:, bright].sum(axis=1).var(ddof=1) / stated[bright].sum()
    p = stats.chi2.sf(chi2, len(images) - 1)
    assert p > 0.5 * LEVEL
    assert p < 1.0 - 0.5 * LEVEL or method == "forward"
