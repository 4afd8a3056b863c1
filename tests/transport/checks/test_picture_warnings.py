"""What the command line says, Python says: each kind of warning in both, and in report.json; none of a clean scene.

Kinds that tell of a scene are provoked by a scene, and kinds that tell of a fault of lfmesh by such a fault.
"""

import json
import warnings
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.errors import PictureWarning
from lfmesh.files import words
from lfmesh.transport import build as worlds
from lfmesh.transport.checks.aim_proof import Missed
from lfmesh.transport.checks.blind_check import BlindSamples
from lfmesh.transport.checks.found import found
from lfmesh.transport.render import render as renders
from lfmesh.transport.render.tracer import Tracer
from lfmesh.transport.sequences import stop_rays
from tests.instances import instances
from tests.study.studies import small_scene
from tests.transport.test_lost import ball_with_normals
from tests.validation.test_order_of_surfaces import spoil_place

Patch = pytest.MonkeyPatch


def scene(**changes: Any) -> lf.Scene:
    """A lens of f/2 that fills 8 × 8 pixels with a plane that shines."""
    front = {"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 7.0, "stop": True}
    shine = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}
    return lf.Scene(
        camera={
            "focus_mm": 100.0,
            "lens": {"surfaces": [front, {"radius_mm": -30.0, "semi_diameter_mm": 7.0}]},
            "sensor": {"pixels": [8, 8], "pixel_mm": 0.05},
        },
        targets=[plane(-100.0) | {"material": shine}],
        transport={"samples": 64, "replicates": 4, "threads": 1, "split": "transmit"},
    ).changed(changes)


def plane(z_mm: float) -> dict[str, Any]:
    return {"shape": {"kind": "plane", "width_mm": 80.0, "height_mm": 80.0}, "position_mm": (0.0, 0.0, z_mm)}


def with_more(*targets: dict[str, Any]) -> lf.Scene:
    return scene(targets=[*scene().targets, *targets])


def black(_: Patch, __: Path) -> lf.Scene:
    """A black board before the one that shines."""
    return with_more(plane(-90.0) | {"material": {"reflectance": 0.0}})


def blind(patch: Patch, _: Path) -> lf.Scene:
    """Let samples that are not aimed find ten times the light."""
    compared = BlindSamples.compared

    def ten_times(own: BlindSamples, *image: Any, **keywords: Any) -> Any:
        own.found = [10.0 * found for found in own.found]
        return compared(own, *image, **keywords)

    patch.setattr(BlindSamples, "compared", ten_times)
    return scene()


def lost(_: Patch, folder: Path) -> lf.Scene:
    ball = ball_with_normals(folder / "ball.obj", 0.07) | {"position_mm": (0.0, 0.0, -60.0)}
    return with_more(ball).changed({"camera.sensor.pixel_mm": 0.5, "transport.samples": 1024})


def opened(patch: Patch, _: Path) -> lf.Scene:
    ledger_of = Tracer.ledger

    def with_more_emitted(*arguments: Any) -> lf.Ledger:
        ledger = ledger_of(*arguments)
        ledger.emitted *= 1.0 + 1e-6
        return ledger

    patch.setattr(Tracer, "ledger", with_more_emitted)
    return scene()


def cut(_: Patch, __: Path) -> lf.Scene:
    return scene(**{"transport.max_events": 1, "transport.engine": "mesh", "transport.split": "both"})


def hidden(_: Patch, __: Path) -> lf.Scene:
    return with_more({"shape": {"kind": "sphere", "radius_mm": 300.0}, "position_mm": (0.0, 0.0, -50.0)})


def fog(_: Patch, __: Path) -> lf.Scene:
    return scene(**{"media": [{"scattering_per_mm": 1e-3}], "transport.method": "forward"})


def spoiled(patch: Patch, spoil: Callable[[Any], None]) -> None:
    """Render worlds with a fault, copies of those that the process keeps."""
    world_of = worlds.world_of

    def faulty(*arguments: Any, **keywords: Any) -> Any:
        world = copy(world_of(*arguments, **keywords))
        spoil(world)
        return world

    patch.setattr(renders, "world_of", faulty)


def outside_aim(patch: Patch, _: Path) -> lf.Scene:
    def spoil(world: Any) -> None:
        aim, proof = world._aim_and_proof
        world._aim_and_proof = aim, proof._replace(sensor=Missed(0.123, 0.001))

    spoiled(patch, spoil)
    return scene()


def heavy(_: Patch, __: Path) -> lf.Scene:
    wall = plane(-100.0)
    lamp = {"kind": "point", "position_mm": (0.0, 0.0, -99.99), "power_w": 1.0}
    return scene(targets=[wall], lights=[lamp], **{"camera.sensor.pixel_mm": 0.5})


def few(_: Patch, __: Path) -> lf.Scene:
    return scene(**{"transport.samples": 8})


def gap(_: Patch, folder: Path) -> lf.Scene:
    trimesh.creation.box((60.0, 60.0, 10.0)).export(folder / "plate.stl")
    plate = {"refractor": {"file": "plate.stl", "units": "mm", "index": 1.5}}
    return with_more(*(plate | {"position_mm": (0.0, 0.0, z)} for z in (-60.0, -70.0 - 1e-4)))


def balls(apart_mm: float) -> lf.Scene:
    """Two balls of glass of 320 facets and a radius of 8 mm, beside each other."""
    trimesh.creation.icosphere(2, 8.0).export("ball.stl")
    ball = {"file": "ball.stl", "units": "mm", "index": 1.5}
    return with_more(
        {"refractor": ball, "position_mm": (0.0, 0.0, -60.0)},
        {"refractor": ball | {"priority": 1}, "position_mm": (apart_mm, 0.0, -60.0)},
    )


def cut_balls(_: Patch, __: Path) -> lf.Scene:
    return balls(8.0)


def coarse(_: Patch, folder: Path) -> lf.Scene:
    """Warm air of 4 mm, in voxels of 2 mm."""
    r2 = sum(np.meshgrid(*[np.linspace(-8.0, 8.0, 9) ** 2] * 3))
    np.savez(folder / "air.npz", index=1.0 - 1e-4 * np.exp(-r2 / 16.0), spacing_mm=2.0)
    return scene(media=[{"grid": "air.npz", "position_mm": (0.0, 0.0, -60.0)}])


def disordered(patch: Patch, _: Path) -> lf.Scene:
    def spoil(world: Any) -> None:
        order = world.tables.lens.order.copy()
        spoil_place(order)
        world.tables = world.tables._replace(lens=world.tables.lens._replace(order=order))

    spoiled(patch, spoil)
    return scene(**{"transport.split": "both"})


def diffraction(_: Patch, __: Path) -> lf.Scene:
    return scene(**{"transport.wavelengths_nm": (20_000.0,)})


CASES: dict[type[PictureWarning], Callable[[Patch, Path], lf.Scene]] = {
    lf.BlackPictureWarning: black,
    lf.BlindCheckWarning: blind,
    lf.LostEnergyWarning: lost,
    lf.OpenLedgerWarning: opened,
    lf.CutPathsWarning: cut,
    lf.HiddenSceneWarning: hidden,
    lf.MissedLightWarning: fog,
    lf.LightOutsideAimWarning: outside_aim,
    lf.HeavyPathsWarning: heavy,
    lf.TooFewSamplesWarning: few,
    lf.ClosedGapWarning: gap,
    lf.CutBodiesWarning: cut_balls,
    lf.FoldedPatchesWarning: lost,
    lf.CoarseFieldWarning: coarse,
    lf.OrderCheckWarning: disordered,
    lf.DiffractionWarning: diffraction,
}


@pytest.fixture
def home(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def warned(make: Callable[[], lf.Image]) -> tuple[lf.Image, list[PictureWarning]]:
    """Return an image, and every warning of the family that came of it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        image = make()
    return image, [each.message for each in caught if isinstance(each.message, PictureWarning)]


def test_every_kind_of_warning_has_a_case() -> None:
    """Of a matrix, which has no report, the case stands below; of volumes and interruptions in tests of their own."""
    elsewhere = {lf.ClearAirWarning, lf.FineVoxelsWarning, lf.InterruptedRenderWarning, lf.UnknownErrorWarning}
    assert {*CASES} | elsewhere == set(PictureWarning.__subclasses__())
    assert all(getattr(lf, kind.__name__) is kind for kind in (PictureWarning, *PictureWarning.__subclasses__()))


@pytest.mark.parametrize("kind", instances(CASES, long=[lf.FoldedPatchesWarning]), ids=lambda kind: kind.__name__)
def test_python_the_command_line_and_the_report_say_the_same(
    kind: type[PictureWarning], home: Path, monkeypatch: Patch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = CASES[kind](monkeypatch, home)
    image, said = warned(lambda: lf.render(given))
    assert kind in map(type, image.warnings)
    assert (lf.LostEnergyWarning in map(type, image.warnings)) == (lf.FoldedPatchesWarning in map(type, image.warnings))
    # Each once, and kept most important first, as it is written.
    assert sorted(map(str, said)) == sorted(map(str, image.warnings))
    ranks = [PictureWarning.__subclasses__().index(type(each)) for each in image.warnings]
    assert ranks == sorted(ranks)
    lf.save(image, home / "by_python")
    assert lf.open_run(home / "by_python").warnings == image.warnings

    (home / "scene.toml").write_text(given.dump_toml(), encoding="utf-8")
    capsys.readouterr()
    assert main(["render", "scene.toml", "-o", "run"]) == 0
    shown = capsys.readouterr()
    err = " ".join(shown.err.split())
    assert "Warning: " not in shown.out
    assert err.count("Warning: ") == len(image.warnings)
    for name in ("by_python", "run"):
        report = json.loads((home / name / "report.json").read_text(encoding="utf-8"))
        assert report["warnings"] == [each.as_dict() for each in image.warnings]
        assert report["summary"][: len(image.warnings)] == [f"Warning: {each}" for each in image.warnings]
    assert all(err.count(f"Warning: {each} [{type(each).__name__}]") == 1 for each in image.warnings)


@pytest.mark.parametrize(
    "kind", [lf.HiddenSceneWarning, lf.ClosedGapWarning, lf.CoarseFieldWarning, lf.DiffractionWarning]
)
def test_a_check_says_once_what_a_render_would_warn_of(
    kind: type[PictureWarning], home: Path, monkeypatch: Patch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = CASES[kind](monkeypatch, home)
    (warning,) = (each for each in warned(lambda: lf.render(given))[1] if isinstance(each, kind))
    (home / "scene.toml").write_text(given.dump_toml(), encoding="utf-8")
    assert main(["check", "scene.toml"]) == 0
    said = " ".join("".join(capsys.readouterr()).split())
    assert said.count(str(warning)) == 1


def lens_of_a_mesh_file(_: Patch, folder: Path) -> lf.Scene:
    """A ball of glass as the lens."""
    trimesh.creation.icosphere(3, 10.0).export(folder / "ball.stl")
    glass = {"refractor": {"file": "ball.stl", "units": "mm", "index": 1.5, "surface": "patch"}}
    lens = {"surfaces": [glass | {"semi_diameter_mm": 3.0}], "stop_semi_diameter_mm": 2.0}
    return scene(**{"camera.lens": lens})


def few_proof_rays(patch: Patch, _: Path) -> lf.Scene:
    """Let so few rays from the stop come through that none of them outside the aim proves little."""
    patch.setattr(stop_rays, "BATCH", 1000)
    patch.setattr(stop_rays, "BATCHES", 1)
    return scene(**{"camera.sensor.pixel_mm": 0.051})


def no_proof_rays(patch: Patch, _: Path) -> lf.Scene:
    """Let none come through, though the sensor has light."""
    patch.setattr(stop_rays, "BATCH", 1)
    patch.setattr(stop_rays, "NEAREST", 1e5)
    patch.setattr(stop_rays, "FURTHEST", 1e6)
    return scene(**{"camera.sensor.pixel_mm": 0.052})


@pytest.mark.parametrize(
    ("case", "words"),
    [
        (lens_of_a_mesh_file, "because the lens has surfaces of mesh files"),
        (few_proof_rays, "test rays cannot rule out less"),
        (no_proof_rays, "no ray from the stop could be traced to the sensor"),
    ],
)
def test_an_aim_that_is_not_proven_is_said(
    case: Callable[[Patch, Path], lf.Scene], words: str, home: Path, monkeypatch: Patch
) -> None:
    image, said = warned(lambda: lf.render(case(monkeypatch, home)))
    (warning,) = (each for each in said if isinstance(each, lf.LightOutsideAimWarning))
    assert words in str(warning)
    assert warning in image.warnings


def test_a_clean_scene_says_nothing(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, said = warned(lambda: lf.render(scene()))
    assert (said, image.warnings) == ([], ())
    (home / "scene.toml").write_text(scene().dump_toml(), encoding="utf-8")
    assert main(["render", "scene.toml", "-o", "run"]) == 0
    assert "Warning" not in "".join(capsys.readouterr())
    assert json.loads((home / "run" / "report.json").read_text(encoding="utf-8"))["warnings"] == []


@pytest.mark.parametrize(
    ("apart_mm", "surface", "told"), [(8.0, "patch", True), (8.0, "flat", False), (17.0, "patch", False)]
)
def test_only_curved_bodies_that_cut_each_other_are_named(
    apart_mm: float, surface: str, told: bool, home: Path
) -> None:
    given = balls(apart_mm)
    level = {f"targets[{i}].refractor.surface": surface for i in (1, 2)}
    assert (lf.CutBodiesWarning in map(type, lf.build(given.changed(level)).warnings)) == told


def test_what_is_known_beforehand_is_said_before_the_first_ray() -> None:
    given, told = fog(None, None), []  # type: ignore[arg-type]

    def keep(*_: Any, **__: Any) -> None:
        told.append([type(each.message) for each in caught])

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        lf.render(given, keep=keep)
    assert lf.MissedLightWarning in told[0]


def test_the_line_that_is_named_is_the_callers() -> None:
    with pytest.warns(lf.MissedLightWarning) as caught:
        lf.render(fog(None, None))  # type: ignore[arg-type]
    assert all(Path(each.filename) == Path(__file__) for each in caught)


def test_a_white_image_says_what_a_render_says() -> None:
    _, said = warned(lambda: lf.white_image(diffraction(None, None)))  # type: ignore[arg-type]
    assert lf.DiffractionWarning in map(type, said)


@pytest.mark.parametrize("way", ["jobs", "shares", "resumed"])
def test_divided_and_resumed_renders_say_the_same(way: str, home: Path) -> None:
    from lfmesh.files.shares import merged, trace_share
    from lfmesh.transport.render.jobs import reduced, traced
    from lfmesh.transport.render.tally import arrays_of
    from lfmesh.transport.render.tracer import Tracer

    given = scene(**{"transport.samples": 8, "transport.wavelengths_nm": (20_000.0,)})
    image, said = warned(lambda: lf.render(given))
    assert {lf.TooFewSamplesWarning, lf.DiffractionWarning} == set(map(type, said))
    kept: list[dict[str, Any]] = []

    def divided() -> lf.Image:
        if way == "jobs":
            return reduced(Tracer(lf.build(given)), lambda jobs: map(traced, jobs), blocks=2)
        if way == "shares":
            for share in (1, 2):
                trace_share(given.pinned(), home / str(share), share, 2)
            return merged([home / "1", home / "2"])
        lf.render(given, keep=lambda state, *, last: kept.append({k: np.copy(v) for k, v in arrays_of(state).items()}))
        return lf.render(given, saved=kept[1])

    other, said_too = warned(divided)
    assert other.warnings == image.warnings
    assert set(said_too) == set(said)


def test_a_projection_matrix_warns_of_clear_air_and_of_what_its_camera_is_known_for(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    smoke = {"absorption_per_mm": 1e-3, "bounds": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": (0, 0, -50)}
    given = scene(**{"media": [smoke], "transport.wavelengths_nm": (20_000.0,)})
    (home / "scene.toml").write_text(given.dump_toml(), encoding="utf-8")
    box = ["--counts", "2", "2", "2", "--size-mm", "4", "4", "4", "--position-mm", "0", "0", "-60"]
    assert main(["matrix", "scene.toml", *box, "-o", "m.npz"]) == 0
    err = " ".join(capsys.readouterr().err.split())
    assert err.count("Warning: media[0]: this projection matrix ignores absorption") == 1
    assert err.count("Warning: the lens's Airy disk") == 1


def test_runs_without_a_list_of_warnings_tell_them_by_their_numbers(home: Path) -> None:
    image, _ = warned(lambda: lf.render(few(None, home)))  # type: ignore[arg-type]
    from lfmesh.transport.checks.found import found

    assert [type(each) for each in found(image)] == [lf.TooFewSamplesWarning]
    assert words.summary(image)[0].startswith("Warning: too few samples")


def test_a_warning_of_a_kind_that_this_version_does_not_know_is_kept() -> None:
    warning = PictureWarning.from_dict({"kind": "OfTheFutureWarning", "text": "something is wrong"})
    assert (type(warning), str(warning)) == (PictureWarning, "something is wrong")


def test_cut_paths_are_measured_by_the_light_that_the_picture_lacks() -> None:
    """Two walls that light each other: of the importance of all pixels a hundredth part reaches them at all."""
    wall = {
        "shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0},
        "material": {"reflectance": 0.8, "radiance_w_m2_sr": 1.0},
    }
    walls = [
        wall | {"position_mm": (0.0, 0.0, -60.0)},
        wall | {"position_mm": (30.0, 0.0, -30.0), "rotation_deg": (0.0, 90.0, 0.0)},
    ]
    room = small_scene(samples=64).changed({"targets": walls})
    whole = lf.render(room)
    with pytest.warns(lf.CutPathsWarning):
        cut = lf.render(room.changed({"transport.max_events": 7}))
    lacks = 1.0 - cut.mean.sum() / whole.mean.sum()
    stated = cut.ledger.depth / (cut.ledger.depth + cut.ledger.reached_target)
    assert lacks > 3e-3
    assert 0.5 < stated / lacks < 2.0
    assert cut.ledger.depth < 1e-4 * cut.ledger.emitted


def test_a_picture_with_values_that_are_no_numbers_is_warned_of() -> None:
    image = lf.render(scene())
    spoiled = image.mean.copy()
    spoiled[0, 0] = np.nan
    told = found(replace(image, mean=spoiled))
    assert any("1 value of the picture is not a number" in str(each) for each in told)
    assert not any("not numbers" in str(each) for each in found(image))
