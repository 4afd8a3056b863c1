"""What the tracer loses is said, with the body in which it was lost; a clean scene says nothing."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.errors import LostEnergyWarning
from lfmesh.files import words
from lfmesh.transport.checks.found import books
from lfmesh.view.rays.launch import from_pixels
from lfmesh.view.rays.path_table import path_table

RADIUS = 8.0


def ball_with_normals(path: Path, noise: float) -> dict[str, Any]:
    """A ball of glass whose normals are off by so many radians, as a file that nothing is visibly wrong with."""
    ball = trimesh.creation.icosphere(3, RADIUS)
    normals = ball.vertices / RADIUS + noise * np.random.default_rng(0).normal(size=ball.vertices.shape)
    lines = [f"v {x} {y} {z}" for x, y, z in ball.vertices] + [f"vn {x} {y} {z}" for x, y, z in normals]
    lines += ["f " + " ".join(f"{i + 1}//{i + 1}" for i in face) for face in ball.faces]
    path.write_text("\n".join(lines) + "\n")
    return {
        "name": "flawed ball",
        "refractor": {"file": str(path), "units": "mm", "index": 1.5},
        "position_mm": (0.0, 0.0, -100.0),
    }


def scene_of(ball: dict[str, Any]) -> lf.Scene:
    """A singlet that looks at a glowing wall through the ball."""
    wall = {"shape": {"kind": "plane", "width_mm": 80.0, "height_mm": 80.0}, "position_mm": (0.0, 0.0, -130.0),
            "material": {"radiance_w_m2_sr": 1.0}}  # fmt: skip
    front = {"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 6.0, "stop": True}
    return lf.Scene(
        camera={
            "focus_mm": 100.0,
            "lens": {"surfaces": [front, {"radius_mm": -30.0, "semi_diameter_mm": 6.0}]},
            "sensor": {"pixels": [16, 16], "pixel_mm": 0.5},
        },
        targets=[wall, ball],
        transport={"samples": 32, "replicates": 2, "engine": "mesh"},
    )


@pytest.fixture(scope="module")
def flawed(tmp_path_factory: pytest.TempPathFactory) -> lf.Scene:
    return scene_of(ball_with_normals(tmp_path_factory.mktemp("flawed") / "ball.obj", 0.07))


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> lf.Scene:
    return scene_of(ball_with_normals(tmp_path_factory.mktemp("clean") / "ball.obj", 0.0))


def test_a_render_that_loses_energy_warns_and_names_the_body(flawed: lf.Scene) -> None:
    with pytest.warns(LostEnergyWarning, match="of the energy was lost by the tracer: .* in flawed ball"):
        image = lf.render(flawed)
    ledger = image.ledger
    # A thousand times what a run may lose without a warning.
    assert ledger.lost_share > 1e-4
    # Said once by reason, once by body: both are all of it, and none of it counts as absorbed.
    assert ledger.lost_in == {"flawed ball": pytest.approx(sum(ledger.lost.values()), rel=1e-12)}
    assert abs(ledger.imbalance) < 1e-12
    assert not any("lost" in name for name in ledger.absorbed)
    said = " ".join(words.summary(image))
    assert f"{ledger.lost_share:.1e} in flawed ball" in said
    assert "crease_deg" in said


def test_a_run_keeps_what_was_lost_where(flawed: lf.Scene, tmp_path: Path) -> None:
    with pytest.warns(LostEnergyWarning):
        image = lf.render(flawed)
    lf.save(image, tmp_path / "run")
    assert lf.open_run(tmp_path / "run").ledger.lost_in == image.ledger.lost_in
    assert "in flawed ball" in (tmp_path / "run" / "report.json").read_text(encoding="utf-8")


def test_clean_glass_raises_no_warning(clean: lf.Scene) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", LostEnergyWarning)
        image = lf.render(clean)
        rays = from_pixels(lf.build(clean), range(16), range(16), 8000)
    assert image.ledger.lost_in == {}
    assert image.ledger.events > 10_000
    assert not any("lost" in line for line in words.summary(image))
    assert not any("lost" in line for line in path_table(rays).lines())


def test_traced_rays_that_are_lost_warn_and_say_where_they_ended(flawed: lf.Scene) -> None:
    world = lf.build(flawed)
    at = np.random.default_rng(1).uniform(-7.0, 7.0, (4000, 2))
    origins = np.column_stack([at, np.full(len(at), -70.0)])
    with pytest.warns(LostEnergyWarning, match="in flawed ball"):
        paths = lf.trace(world, origins, np.tile([0.0, 0.0, -1.0], (len(at), 1)))
    lost = np.flatnonzero(paths.status == lf.Status.LOST)
    assert {paths.body[i] for i in lost} == {"lost in flawed ball"}
    assert paths.weight[lost].sum() == pytest.approx(sum(paths.ledger.lost_in.values()), rel=1e-12)


def test_the_path_table_says_what_was_lost(flawed: lf.Scene) -> None:
    table = path_table(from_pixels(lf.build(flawed), range(16), range(16), 8000))
    last = table.lines(most=0)[-1]
    assert last.startswith("Warning: ")
    assert "of the energy was lost by the tracer" in last
    assert "in flawed ball" in last
    assert any("lost in flawed ball" in row.sequence for row in table)


def test_a_faceted_body_that_cuts_nothing_loses_nothing(tmp_path: Path) -> None:
    """Rays leave a crumpled ball near edges, where float32 finds neighbours that they pass: that is no loss."""
    ball = trimesh.creation.icosphere(4, RADIUS)
    scale = 1.0 + 0.02 * np.random.default_rng(0).normal(size=(len(ball.vertices), 1))
    trimesh.Trimesh(ball.vertices * scale, ball.faces, process=False).export(tmp_path / "rough.stl")
    rough = {"refractor": {"file": str(tmp_path / "rough.stl"), "units": "mm", "index": 1.5, "surface": "flat"}}
    world = lf.build(scene_of({**rough, "position_mm": (0.0, 0.0, -100.0)}))
    draw = np.random.default_rng(3)
    n = 60_000
    origins = np.column_stack([draw.uniform(-14.0, 14.0, (n, 2)), np.full(n, -70.0)])
    towards = np.column_stack([draw.uniform(-12.0, 12.0, (n, 2)), draw.uniform(-118.0, -90.0, n)])
    paths = lf.trace(world, origins, towards - origins, weight_cutoff=0.3)
    assert paths.ledger.events > 100_000
    assert paths.ledger.lost_in == {}


BOX = {"name": "window", "refractor": {"box_mm": (9.0, 9.0, 2.0), "index": 1.5}, "position_mm": (0.0, 0.0, -80.0)}
TANK = {
    "size_mm": (8.0, 8.0, 8.0),
    "wall_mm": 1.0,
    "wall": {"index": 1.5},
    "liquid": {"index": 1.33},
    "position_mm": (0.0, 0.0, -120.0),
}
OF_MESHES = ("mesh file", "crease_deg", 'surface = "flat"')


@pytest.mark.parametrize(
    ("bodies", "said", "unsaid"),
    [
        (["flawed ball"], OF_MESHES, ("box",)),
        (["window"], ("box_mm",), OF_MESHES),
        (["tanks[0] liquid"], ("size_mm of a tank",), OF_MESHES),
        (["flawed ball", "window"], (*OF_MESHES, "box_mm"), ()),
        (["the open"], (), (*OF_MESHES, "box")),
    ],
)
def test_advice_on_lost_energy_is_one_that_the_body_accepts(
    bodies: list[str], said: tuple[str, ...], unsaid: tuple[str, ...], flawed: lf.Scene
) -> None:
    """Boxes have no facets to make finer and no normals to estimate: `crease_deg` is refused of them."""
    scene = lf.build(flawed.changed({"targets": [*flawed.targets, BOX], "tanks": [TANK]})).scene
    ledger = lf.Ledger(emitted=1.0, escaped=1.0 - 1e-4, lost={"miss": 1e-4}, lost_in=dict.fromkeys(bodies, 1e-4))
    (warning,) = books(scene, ledger)
    assert isinstance(warning, LostEnergyWarning)
    advice = str(warning).partition("the picture lacks it")[2]
    assert all(words in advice for words in said), advice
    assert not any(words in advice for words in unsaid), advice
    with pytest.raises(lf.SceneError, match=r"crease_deg = 30.0: box_mm is given too"):
        lf.Scene(**flawed.model_dump() | {"targets": [BOX | {"refractor": BOX["refractor"] | {"crease_deg": 30.0}}]})
