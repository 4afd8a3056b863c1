"""Shares of a render: together they have the bits of the whole, and no part is taken for another's or for the whole."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh import provenance
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.errors import FileError, LfmeshError
from lfmesh.files import sealed
from lfmesh.files.shares import FACTS, PIECES, merged, trace_share
from lfmesh.transport.render.tracer import Tracer
from tests.cameras import close_up_camera

PLANE = {
    "shape": {"kind": "plane", "width_mm": 7.0, "height_mm": 6.0},
    "position_mm": [0, 0, -60.0],
    "material": {"reflectance": 0.8, "radiance_w_m2_sr": 100.0},
}
LAMP = {"kind": "point", "position_mm": [20.0, -15.0, -25.0], "power_w": 1.0}
SCENES = {
    "reflections": ({"transport.split": "both", "transport.samples": 12}, ()),
    "forward": ({"transport.method": "forward"}, ()),
    # Its folder keeps another path.
    "texture": ({"targets[0].material.texture": str(asset_path("charts/chart.png"))}, ()),
    "lamp, two wavelengths": (
        {"transport.split": "transmit", "transport.wavelengths_nm": [500.0, 600.0]},
        (LAMP,),
    ),
}


@pytest.fixture
def scene_of() -> Callable[[str], lf.Scene]:
    def scene(name: str) -> lf.Scene:
        changes, lights = SCENES[name]
        bodies = {"targets": [PLANE], "lights": list(lights)}
        return (
            lf.Scene(camera=close_up_camera(20, 16), **bodies).changed({"transport.replicates": 4} | changes).pinned()
        )

    return scene


def same_bits(one: lf.Image, other: lf.Image) -> None:
    for name in ("mean", "stderr", "hits", "error", "upper"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
    assert one.ledger == other.ledger
    assert one.blind == other.blind


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("shares", [1, 3])
def test_shares_together_have_the_bits_of_the_whole(
    name: str, shares: int, scene_of: Callable[[str], lf.Scene], tmp_path: Path
) -> None:
    scene = scene_of(name)
    folders = [tmp_path / str(number) for number in range(shares)]
    counts = [trace_share(scene, folder, number, shares) for number, folder in enumerate(folders, start=1)]
    assert min(counts) > 0
    same_bits(merged(folders[::-1]), lf.render(scene))


def test_shares_may_have_a_folder_in_common(scene_of: Callable[[str], lf.Scene], tmp_path: Path) -> None:
    scene = scene_of("reflections")
    for number in (2, 1):
        trace_share(scene, tmp_path / "all", number, 2)
    same_bits(merged([tmp_path / "all"]), lf.render(scene))


def test_a_share_goes_on_where_it_was_stopped(
    scene_of: Callable[[str], lf.Scene], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, traced = scene_of("reflections"), []
    piece = Tracer.piece

    def counted(self: Tracer, replicate: int, *others: object) -> object:
        if len(traced) == 2:
            raise KeyboardInterrupt
        traced.append(replicate)
        return piece(self, replicate, *others)

    monkeypatch.setattr(Tracer, "piece", counted)
    with pytest.raises(KeyboardInterrupt):
        trace_share(scene, tmp_path / "a", 1, 1)
    traced[:] = [0, 0, 0]
    count = trace_share(scene, tmp_path / "a", 1, 1)
    assert len(traced) - 3 == count - 2
    same_bits(merged([tmp_path / "a"]), lf.render(scene))


def test_nothing_but_the_whole_is_merged(scene_of: Callable[[str], lf.Scene], tmp_path: Path) -> None:
    scene = scene_of("reflections")
    one, two, other = (tmp_path / name for name in ("one", "two", "other"))
    trace_share(scene, one, 1, 2)
    with pytest.raises(FileError, match=r"of share 2/2"):
        merged([one])
    trace_share(scene, two, 2, 2)
    trace_share(scene.changed({"transport.seed": 5}), other, 2, 2)
    with pytest.raises(FileError, match="another render"):
        merged([one, other])
    with pytest.raises(FileError, match="another render"):
        trace_share(scene, other, 2, 2)
    with pytest.raises(FileError, match="no share"):
        merged([one, tmp_path])
    pieces = sorted((two / PIECES).iterdir())
    # A piece under the name of another one, the same of another render, and one that was cut short.
    shutil.copy(pieces[0], pieces[1])
    with pytest.raises(FileError, match="another piece"):
        merged([one, two])
    shutil.copy(other / PIECES / pieces[1].name, pieces[1])
    with pytest.raises(FileError, match="a piece of another render"):
        merged([one, two])
    trace_share(scene, two, 2, 2)
    same_bits(merged([one, two]), lf.render(scene))
    pieces[1].write_bytes(pieces[1].read_bytes()[:200])
    with pytest.raises(FileError, match="damaged"):
        merged([one, two])
    # What cannot be read is traced again.
    trace_share(scene, two, 2, 2)
    same_bits(merged([one, two]), lf.render(scene))
    for damaged in ("{}", (one / FACTS).read_text().replace("60.0", "61.0", 1)):
        (one / FACTS).write_text(damaged)
        for folders in ([one, two], [two, one]):
            with pytest.raises(FileError, match=r"one.render\.json is damaged"):
                merged(folders)


def test_shares_of_another_program_are_refused_and_of_another_processor_warned_of(
    scene_of: Callable[[str], lf.Scene], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, own = scene_of("reflections"), provenance.program()
    trace_share(scene, tmp_path / "a", 1, 1)
    with monkeypatch.context() as patched:
        patched.setattr(sealed, "processor", lambda: "another")
        with pytest.warns(sealed.ProcessorWarning, match="here another"):
            merged([tmp_path / "a"])
    monkeypatch.setattr(provenance, "program", lambda: own | {"sources": "others"})
    with pytest.raises(FileError, match=f"sources {own['sources']}, here others"):
        merged([tmp_path / "a"])


def test_another_number_of_threads_is_the_same_render(scene_of: Callable[[str], lf.Scene], tmp_path: Path) -> None:
    scene = scene_of("reflections")
    for number in (1, 2):
        trace_share(scene.changed({"transport.threads": number}), tmp_path / "all", number, 2)
    assert np.array_equal(merged([tmp_path / "all"]).mean, lf.render(scene).mean)


def test_what_cannot_be_divided_or_written_is_one_line(scene_of: Callable[[str], lf.Scene], tmp_path: Path) -> None:
    scene = scene_of("reflections")
    with pytest.raises(LfmeshError, match=r"transport\.target_error"):
        trace_share(scene.changed({"transport.target_error": 0.1}), tmp_path / "a", 1, 2)
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="cannot be written"):
        trace_share(scene, tmp_path / "file", 1, 2)
    with pytest.raises(FileError, match="not a share of a render"):
        trace_share(scene, tmp_path, 1, 2)


def test_the_command_line_makes_the_run_of_all_shares(
    scene_of: Callable[[str], lf.Scene], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    scene = scene_of("reflections")
    Path("scene.toml").write_text(scene.dump_toml())
    for number in (1, 2):
        assert main(["render", "scene.toml", "-o", f"part{number}", "--shard", f"{number}/2"]) == 0
    assert main(["render", "--merge", "part1", "part2", "-o", "run"]) == 0
    same_bits_on_disk = lf.open_run("run").mean
    assert np.array_equal(same_bits_on_disk, lf.render(scene).mean.astype(np.float32))
    capsys.readouterr()
    for words, fault in (
        (["scene.toml", "-o", "x", "--shard", "3/2"], "--shard 3/2"),
        (["scene.toml", "-o", "x", "--shard", "1/2", "--dask", "local"], "cannot be combined: give one of them"),
        (["scene.toml", "-o", "x", "--shard", "1/2", "--white"], "--white"),
        (["scene.toml", "-o", "x", "--shard", "1/2", "--restart"], "cannot be combined with --shard: omit it"),
        (["--merge", "part1", "part2", "-o", "x", "--restart"], "cannot be combined with --merge: omit it"),
        (["--resume", "part1", "--restart"], "cannot be combined with --resume: omit it"),
        (["--merge", "part1", "part2"], "--out"),
        (["--merge", "part1", "part2", "-o", "x", "--seed", "3"], "--seed"),
    ):
        assert main(["render", *words]) == 2
        assert fault in capsys.readouterr().err
        assert not Path("x").exists()
