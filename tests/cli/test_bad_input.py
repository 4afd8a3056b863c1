"""Bad input gets one clear line and exit code 2, and writes nothing half-done."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import trimesh

import lfmesh
from lfmesh.cli import main
from tests.cameras import bench_camera
from tests.processor_time import HANGS_S

SCENE = f"""{bench_camera(4, 4)}[[targets]]
file = "part.stl"
units = "mm"
position_mm = [0.0, 0.0, -500.0]
[[targets]]
shape = {{ kind = "plane", width_mm = 60.0, height_mm = 60.0 }}
position_mm = [0.0, 0.0, -540.0]
[targets.material]
texture = "chart.png"
[[lights]]
kind = "point"
position_mm = [100.0, -100.0, -50.0]
power_w = 1.0
[transport]
samples = 2
replicates = 2
split = "transmit"
"""

GLB = ('file = "part.stl"\nunits = "mm"', 'file = "part.glb"')


def opened(body: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """A body's vertices and its faces but one."""
    return np.asarray(body.vertices), np.asarray(body.faces)[1:]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a scene that renders: its mesh, its picture."""
    monkeypatch.chdir(tmp_path)
    box = trimesh.creation.box(extents=(20.0, 20.0, 20.0))
    box.export(tmp_path / "part.stl")
    box.export(tmp_path / "part.glb")
    PIL.Image.fromarray(np.full((8, 8), 128, np.uint8)).save(tmp_path / "chart.png")
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path


def complaint(capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one error there was, and insist that there was no other.

    Notes on the optics may stand before it, and that kernels are compiled.
    """
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Traceback" not in captured.err
    error = re.sub(r"^(Note: .*\n(  .*\n)*|compiling kernels.*\n)", "", captured.err, flags=re.MULTILINE)
    assert error.startswith("lfmesh: ")
    assert error.endswith("\n")
    assert error.count("\n") == 1, f"one line, not\n{error}"
    return error.removeprefix("lfmesh: ").rstrip("\n")


def files(folder: Path) -> dict[str, bytes | None]:
    """Return all that lies in a folder; None for a folder in it."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")
    }


def test_the_scene_that_all_faults_are_put_into_renders(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Else every one of them might be refused for a reason of its own."""
    for text in (SCENE, SCENE.replace(*GLB)):
        (folder / "scene.toml").write_text(text)
        assert main(["check", "scene.toml"]) == 0
        assert main(["render", "scene.toml", "-o", "run"]) == 0
        assert "lfmesh: " not in capsys.readouterr().err


SAID_BY_THE_SCENE = {
    "unknown key": ("samples = 2", "samples = 2\nsample = 2", "unknown key (did you mean 'samples'?)"),
    "nan": ("focus_mm = 500.0", "focus_mm = nan", "camera.focus_mm = nan"),
    "infinite": ("power_w = 1.0", "power_w = inf", "lights[0].power_w = inf"),
    "spot without a cone": ('kind = "point"', 'kind = "spot"\ndirection = [0, 0, -1]', "half_angle_deg: missing"),
    "gloss of two kinds": (
        "[targets.material]",
        '[targets.material]\ngloss = { index = 1.5, metal = "Al", roughness = 0.1 }',
        "gloss.metal",
    ),
    "gloss as smooth as a mirror": (
        "[targets.material]",
        "[targets.material]\ngloss = { index = 1.5, roughness = 0.001 }",
        "gloss.roughness = 0.001: must be 0.01 or more",
    ),
    "unknown metal": (
        "[targets.material]",
        '[targets.material]\ngloss = { metal = "Unobtainium", roughness = 0.1 }',
        "metals are named by their symbols",
    ),
    "opacity above one": ("[targets.material]", "[targets.material]\nopacity = 1.5", "material.opacity"),
    "unknown opacity": ("[targets.material]", '[targets.material]\nopacity = "alpha"', "material.opacity"),
    "negative thickness": ("thickness_mm = 4.0", "thickness_mm = -4.0", "camera.lens.surfaces[1].thickness_mm = -4"),
    "crossing surfaces": ("thickness_mm = 4.0", "thickness_mm = 0.1", "cross"),
    "unknown glass": ("index = 1.5, semi", 'glass = "SCHOTT/N-BK77", semi', "N-BK77"),
    "unknown coating": ("index = 1.5, semi", 'index = 1.5, coating = "ar", semi', "no coating has this name"),
    "coating without thickness": (
        "[transport]",
        "[coatings.ar]\nlayers = [{ index = 1.38 }]\n[transport]",
        "coatings.ar.layers[0].thickness_nm",
    ),
    "two kinds of coating": (
        "[transport]",
        "[coatings.ar]\nreflectance = 0.1\nlayers = [{ index = 1.4, thickness_nm = 9.0 }]\n[transport]",
        "reflectance is given too",
    ),
    "missing mesh": ('"part.stl"', '"gone.stl"', "gone.stl"),
    "mesh without units": ('units = "mm"\n', "", 'give units, e.g. "mm"'),
    "unknown kind of mesh": ('"part.stl"', '"chart.png"', "must end in one of .stl"),
    "missing texture": ('"chart.png"', '"gone.png"', "gone.png"),
    "absurd sensor": ("pixels = [40, 40]", "pixels = [4000000, 4000000]", " GB of memory"),
    "absurd array": ("count = [4, 4]", "count = [4000000, 4000000]", " GB of memory"),
    "refractor": ('units = "mm"\n', 'units = "mm"\nrefractor = { glass = "SCHOTT/N-BK7" }\n', "targets[0].refractor"),
    "half a file": ('[[lights]]\nkind = "point"', '[[lights]\nkind = "point"', "not valid TOML"),
}
"""What the scene file alone shows; `check` says it too."""


@pytest.mark.parametrize(("old", "new", "reason"), SAID_BY_THE_SCENE.values(), ids=SAID_BY_THE_SCENE)
@pytest.mark.parametrize("command", ["check scene.toml", "render scene.toml -o run"])
def test_a_wrong_scene_gets_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], command: str, old: str, new: str, reason: str
) -> None:
    assert old in SCENE
    (folder / "scene.toml").write_text(SCENE.replace(old, new, 1))
    before = files(folder)
    assert main(command.split()) == 2
    message = complaint(capsys)
    assert message.startswith("scene.toml")
    assert reason in message
    assert files(folder) == before


def test_max_samples_without_a_target_error_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = files(folder)
    assert main(["render", "scene.toml", "-o", "run", "--max-samples", "256"]) == 2
    assert "--max-samples = 256: has no effect without --target-error" in complaint(capsys)
    assert files(folder) == before


def test_every_fault_of_a_file_is_said_at_once(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    faults = [SAID_BY_THE_SCENE[name] for name in ("unknown key", "nan", "missing texture")]
    text = SCENE
    for old, new, _ in faults:
        text = text.replace(old, new, 1)
    (folder / "scene.toml").write_text(text)
    assert main(["render", "scene.toml", "-o", "run"]) == 2
    error = capsys.readouterr().err
    assert error.count("lfmesh: ") == 1
    for _, _, reason in faults:
        assert reason in error
    assert not (folder / "run").exists()


def cut(name: str, share: float) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        whole = (folder / name).read_bytes()
        (folder / name).write_bytes(whole[: int(share * len(whole))])

    return damage


def fill(name: str, content: bytes) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        (folder / name).write_bytes(content)

    return damage


GARBAGE = bytes(range(256)) * 16

SAID_BY_THE_FILES = {
    "empty STL": (fill("part.stl", b""), None, "part.stl: holds no facets"),
    "truncated binary STL": (cut("part.stl", 0.6), None, "part.stl: "),
    "garbage STL": (fill("part.stl", GARBAGE), None, "part.stl: "),
    "STL without facets": (fill("part.stl", b"solid a\nendsolid a\n"), None, "part.stl: holds no facets"),
    "empty GLB": (fill("part.glb", b""), GLB, "part.glb: broken"),
    "truncated GLB": (cut("part.glb", 0.6), GLB, "part.glb: broken"),
    "garbage GLB": (fill("part.glb", GARBAGE), GLB, "part.glb: broken"),
    "texture that is no picture": (fill("chart.png", b"no picture"), None, "chart.png: not a picture"),
    "truncated texture": (cut("chart.png", 0.5), None, "targets[1].material.texture: "),
    "profile that is none": (
        fill("lamp.ies", GARBAGE),
        ('kind = "point"', 'kind = "point"\nprofile = "lamp.ies"'),
        "lamp.ies: has no line that begins with TILT=",
    ),
    "profile cut short": (
        fill("lamp.ies", b"TILT=NONE\n1 -1 1 2 1 1 2 0 0 0\n1 1 40\n0 180\n0\n7\n"),
        ('kind = "point"', 'kind = "point"\nprofile = "lamp.ies"'),
        "lamp.ies: cut short",
    ),
    "coating's table that is none": (
        fill("r.csv", GARBAGE),
        ("[camera.sensor]", 'flat_coating = "ar"\n[coatings.ar]\ntable = "r.csv"\n[camera.sensor]'),
        "r.csv: byte ",
    ),
    "coating's table with a gap": (
        fill("r.csv", b"wavelength_nm,angle_deg,reflectance\n500,0,0.1\n500,90,1\n600,0,0.1\n"),
        ("[camera.sensor]", 'flat_coating = "ar"\n[coatings.ar]\ntable = "r.csv"\n[camera.sensor]'),
        "r.csv: there is no reflectance for 600 nm at 90 degrees",
    ),
    "target in the camera": (
        cut("part.stl", 1.0),
        (
            'file = "part.stl"\nunits = "mm"\nposition_mm = [0.0, 0.0, -500.0]',
            'shape = { kind = "sphere", radius_mm = 2.0 }',
        ),
        "targets[0] reaches into the camera",
    ),
    "target round the camera": (
        cut("part.stl", 1.0),
        ("position_mm = [0.0, 0.0, -500.0]", "position_mm = [0.0, 0.0, 2.0]"),
        "targets[0] reaches into the camera",
    ),
    "sheet through the camera": (
        cut("part.stl", 1.0),
        ("position_mm = [0.0, 0.0, -540.0]", "position_mm = [20.0, 10.0, 12.0]\nrotation_deg = [20.0, 0.0, 0.0]"),
        "targets[1] reaches into the camera",
    ),
    "facets for the sequential engine": (
        cut("part.stl", 1.0),
        ("[transport]", '[transport]\nengine = "sequential"\nsurface = "flat"'),
        'transport.engine = "sequential": surface = "flat"',
    ),
    "an open mesh as a refractor": (
        lambda folder: trimesh.Trimesh(*opened(trimesh.creation.box(extents=(20.0, 20.0, 20.0)))).export(
            folder / "part.stl"
        ),
        (
            'file = "part.stl"\nunits = "mm"',
            'refractor = { file = "part.stl", units = "mm", index = 1.5 }',
        ),
        "a refractor must be a closed body; 3 of its edges belong to only one facet",
    ),
}
"""What shows only when the scene is built."""


@pytest.mark.parametrize(("damage", "change", "reason"), SAID_BY_THE_FILES.values(), ids=SAID_BY_THE_FILES)
def test_a_scene_that_cannot_be_built_gets_one_line(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    damage: Callable[[Path], None],
    change: tuple[str, str] | None,
    reason: str,
) -> None:
    text = SCENE
    if change:
        assert change[0] in SCENE
        text = SCENE.replace(*change)
    (folder / "scene.toml").write_text(text)
    damage(folder)
    before = files(folder)
    assert main(["render", "scene.toml", "-o", "deep/run"]) == 2
    assert reason in complaint(capsys)
    assert files(folder) == before


def test_an_older_run_survives_a_failed_one(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", "scene.toml", "-o", "run"]) == 0
    before = files(folder / "run")
    assert "raw.exr" in before
    fill("part.stl", GARBAGE)(folder)
    capsys.readouterr()
    assert main(["render", "scene.toml", "-o", "run"]) == 2
    assert "part.stl" in complaint(capsys)
    assert files(folder / "run") == before
    assert lfmesh.open_run("run").complete


def unwritable_places(folder: Path) -> list[Path]:
    """Places where no run can be written, whoever the user is."""
    places = [folder / "scene.toml", folder / "scene.toml" / "run", folder / ("n" * 300)]
    if sys.platform == "linux":
        places.append(Path("/proc/run"))
    return places


def test_an_unwritable_folder_is_said_before_anything_is_traced(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import lfmesh.transport.render.render

    monkeypatch.setattr(lfmesh.transport.render.render, "render", lambda *_, **__: pytest.fail("rendered all the same"))
    before = files(folder)
    for place in unwritable_places(folder):
        assert main(["render", "scene.toml", "-o", str(place)]) == 2
        assert str(place) in complaint(capsys)
    assert files(folder) == before


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_the_right_to_write_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    locked = folder / "locked"
    locked.mkdir(mode=0o500)
    assert main(["render", "scene.toml", "-o", "locked/run"]) == 2
    assert "cannot be written" in complaint(capsys)
    assert list(locked.iterdir()) == []


@pytest.mark.parametrize("name", ["truncated GLB", "unknown key"])
def test_a_process_says_it_the_same_way(folder: Path, name: str) -> None:
    if name in SAID_BY_THE_FILES:
        damage, change, reason = SAID_BY_THE_FILES[name]
        damage(folder)
    else:
        *change, reason = SAID_BY_THE_SCENE[name]
    (folder / "scene.toml").write_text(SCENE.replace(*change))
    before = files(folder)
    done = subprocess.run(
        [sys.executable, "-m", "lfmesh", "render", "scene.toml", "-o", "run"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=HANGS_S,
        env={**os.environ, "PYTHONPATH": str(Path(lfmesh.__file__).parents[1])},
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("lfmesh: ")
    assert done.stderr.count("\n") == 1
    assert reason in done.stderr
    assert files(folder) == before


@pytest.mark.parametrize(
    ("share", "reason"),
    [("3/2", "there is no share 3 of 2"), ("0/2", "give the share's number"), ("2", "give the share's number")],
)
def test_a_share_that_there_is_not_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], share: str, reason: str
) -> None:
    assert main(["render", "scene.toml", "-o", "run", "--shard", share]) == 2
    assert f"--shard {share}: {reason}" in complaint(capsys)
