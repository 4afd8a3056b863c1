"""An item of a dataset follows from template, seed and number alone, however the dataset was made."""

import json
import shutil
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image as Picture
from scipy.stats import kstest, norm, uniform

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.files import exr, run
from lfmesh.study.datasets import dataset as dataset_module
from lfmesh.study.datasets.dataset_item import Item
from lfmesh.study.sweeps import pool
from tests.cameras import SQUARE_ARRAY
from tests.study.studies import small_scene

DEPTH = "targets[0].position_mm[2]"
TEXTURE = "targets[0].material.texture"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A template, two textures and a dataset file."""
    place = tmp_path_factory.mktemp("template")
    (place / "scene.toml").write_text(small_scene(samples=4, replicates=2).dump_toml())
    (place / "textures").mkdir()
    for name, grey in (("dark", 40), ("light", 200)):
        Picture.fromarray(np.full((4, 4), grey, np.uint8)).save(place / "textures" / f"{name}.png")
    (place / "dataset.toml").write_text(
        'scene = "scene.toml"\nviews = 3\n'
        f'[[random]]\npath = "{DEPTH}"\nuniform = [-70.0, -50.0]\n'
        f'[[random]]\npath = "{TEXTURE}"\nfiles = "textures"\n'
        '[[random]]\npath = "camera.pose.shift_mm[0]"\nuniform = [-1.0, 1.0]\n'
    )
    return place


@pytest.fixture(scope="module")
def whole(folder: Path) -> Path:
    """The dataset that all tests here compare with."""
    assert (
        main(["dataset", str(folder / "dataset.toml"), "-o", str(folder / "all"), "--count", "3", "--workers", "0"])
        == 0
    )
    return folder / "all"


def test_parts_that_an_array_cannot_be_decoded_for_are_refused_before_anything_is_traced() -> None:
    mla = {name: value for name, value in SQUARE_ARRAY.items() if name != "focal_length_mm"}
    scene = small_scene().changed({"camera.mla": mla | {"radius_mm": 3.0, "back": {"radius_mm": 3.0}}})
    draw = {"path": DEPTH, "uniform": [-70.0, -50.0]}
    with pytest.raises(
        lf.LfmeshError, match=r"item 0 .*: camera\.mla\.back: arrays with lenslets on both faces are not"
    ):
        lf.Dataset(scene, [draw], count=1)
    assert len(lf.Dataset(scene, [draw], count=1, parts=[])) == 1


def index_of(data: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (data / "index.jsonl").read_text().splitlines()]


def numbers(draw: dict[str, Any], count: int, seed: int = 0) -> list[float]:
    dataset = lf.Dataset(small_scene(), [{"path": DEPTH, **draw}], count=1, seed=seed)
    return [dataset.drawn(number)[DEPTH] for number in range(count)]


@pytest.mark.parametrize(
    ("draw", "law"),
    [
        ({"uniform": (-70.0, -50.0)}, uniform(-70.0, 20.0)),
        ({"normal": (-60.0, 3.0)}, norm(-60.0, 3.0)),
        ({"uniform": (-5.0, 5.0), "relative": True}, uniform(-65.0, 10.0)),
    ],
)
def test_draws_have_their_distribution(draw: dict[str, Any], law: Any) -> None:
    """Kolmogorov and Smirnov's test of 2000 draws, at a level of 1e-4."""
    assert kstest(numbers(draw, 2000), law.cdf).pvalue > 1e-4


def test_the_time_left_of_a_dataset_leaves_out_the_first_item_which_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first item takes 300 s and the others 10 s; a clock of the test says so."""
    clock = [0.0]

    def compute(item: Item, _: Path) -> bytes:
        clock[0] += 10.0 if item.point else 300.0
        return b"{}"

    time = SimpleNamespace(perf_counter=lambda: clock[0])
    for module in (dataset_module, pool):
        monkeypatch.setattr(module, "time", time)
    monkeypatch.setattr(Item, "compute", compute)
    told: list[Any] = []
    draw = {"path": DEPTH, "uniform": (-70.0, -50.0)}
    lf.Dataset(small_scene(), [draw], count=6, parts=[]).make(tmp_path, workers=0, progress=told.append)
    assert [now.seconds for now in told] == [0.0, 300.0, 310.0, 320.0, 330.0, 340.0, 350.0]
    assert [now.seconds_left for now in told] == pytest.approx([None, None, 40.0, 30.0, 20.0, 10.0, 0.0])
    assert told[1].in_words("items", "item") == "1 of 6 items"
    assert told[2].in_words("items", "item") == "2 of 6 items, 6 per minute, 40 s left"


def test_items_do_not_depend_on_their_count_or_on_other_draws() -> None:
    draw, other = (
        {"path": DEPTH, "uniform": (-70.0, -50.0)},
        {"path": "targets[0].position_mm[0]", "normal": (0.0, 1.0)},
    )
    few, many = (lf.Dataset(small_scene(), [draw], count=n) for n in (2, 9))
    more = lf.Dataset(small_scene(), [other, draw], count=2)
    assert few.scene(1) == many.scene(1)
    assert few.digest == many.digest
    assert more.drawn(1)[DEPTH] == few.drawn(1)[DEPTH]
    assert more.drawn(1)[DEPTH] != lf.Dataset(small_scene(), [draw], count=2, seed=1).drawn(1)[DEPTH]
    assert len({many.scene(i).transport.seed for i in range(9)}) == 9


@pytest.mark.parametrize("way", ["files", "values"])
def test_an_item_whose_file_has_changed_since_the_dataset_was_read_fails(tmp_path: Path, way: str) -> None:
    for name in ("a", "b"):
        Picture.fromarray(np.full((4, 4), 90, np.uint8)).save(tmp_path / f"{name}.png")
    draws: list[dict[str, Any]] = [{"path": TEXTURE, "files": "*.png"}]
    if way == "values":
        of = [{"radiance_w_m2_sr": 1.0, "texture": name} for name in ("a.png", "b.png")]
        draws = [{"path": "targets[0].material", "values": of}]
    scene = small_scene(samples=4, replicates=2).in_folder(tmp_path)
    data = lf.Dataset(scene, draws, folder=tmp_path, count=6, parts=[])
    drawn = [Path(data.scene(number).targets[0].material.texture or "").name for number in range(6)]
    assert len(set(drawn)) == 2
    Picture.fromarray(np.full((4, 4), 200, np.uint8)).save(tmp_path / "b.png")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lf.PictureWarning)
        made = data.make(tmp_path / "data", workers=0)
    assert sorted(made.failed) == [number for number, name in enumerate(drawn) if name == "b.png"]
    assert all("b.png has changed" in reason for reason in made.failed.values())


def test_every_item_has_what_was_drawn(whole: Path) -> None:
    lines = index_of(whole)
    assert [line["item"] for line in lines] == [0, 1, 2]
    for line in lines:
        place = whole / line["folder"]
        image = lf.open_run(place)
        assert image.scene.targets[0].position_mm[2] == line["drawn"][DEPTH]
        assert Path(str(image.scene.targets[0].material.texture)).name == Path(line["drawn"][TEXTURE]).name
        # The plane faces the camera: its depth is everywhere where it stands.
        depth = exr.read_map(place / "depth_views.exr", ["Z"])
        known = depth[np.isfinite(depth)]
        assert known.size
        assert known == pytest.approx(-line["drawn"][DEPTH], rel=1e-5)
        assert run.pixels_digest(place) == line["pixels_sha256"]
        assert (place / "lightfield.exr").is_file()


def test_a_camera_that_only_moves_has_one_white_image(whole: Path) -> None:
    (camera,) = (whole / "cameras").iterdir()
    assert {line["camera"] for line in index_of(whole)} == {f"cameras/{camera.name}"}
    assert {"raw.exr", "calibration.json", "camera.exr"} <= {path.name for path in camera.iterdir()}


def test_an_item_is_the_render_of_its_scene(folder: Path, whole: Path) -> None:
    dataset = lf.Dataset.load(folder / "dataset.toml", count=2)
    mine = lf.render(dataset.scene(1))
    assert np.array_equal(lf.open_run(whole / "items/000001").mean, mine.mean.astype(np.float32))


def test_shards_in_one_folder_and_damage_give_the_same_index(folder: Path, whole: Path) -> None:
    command = ["dataset", str(folder / "dataset.toml"), "-o", str(folder / "parts"), "--workers", "0", "--count"]
    (folder / "parts").mkdir()
    shutil.copytree(whole / "cameras", folder / "parts" / "cameras")
    assert main([*command, "3", "--shard", "2/2"]) == 0
    assert [line["item"] for line in index_of(folder / "parts")] == [1]
    before = (folder / "parts/items/000001/raw.exr").stat().st_mtime_ns
    assert main([*command, "2"]) == 0
    shutil.copy(folder / "parts/items/000001/item.json", folder / "parts/items/000000/item.json")
    (folder / "parts/items/.lfmesh-1-cut-short").mkdir()
    assert main([*command, "3"]) == 0
    assert (folder / "parts/index.jsonl").read_bytes() == (whole / "index.jsonl").read_bytes()
    assert (folder / "parts/items/000001/raw.exr").stat().st_mtime_ns == before
    assert "unreadable" in (folder / "parts/log.jsonl").read_text()


def test_another_seed_is_refused_in_a_folder(folder: Path, whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (whole / "dataset.json").read_bytes()
    assert main(["dataset", str(folder / "dataset.toml"), "-o", str(whole), "--count", "3", "--seed", "1"]) == 2
    assert "holds another dataset" in capsys.readouterr().err
    assert (whole / "dataset.json").read_bytes() == before


def test_another_program_is_refused_in_a_folder(
    folder: Path, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    facts = json.loads((whole / "dataset.json").read_text())
    facts["program"]["sources"] = "others"
    (tmp_path / "dataset.json").write_text(json.dumps(facts))
    assert main(["dataset", str(folder / "dataset.toml"), "-o", str(tmp_path), "--count", "3"]) == 2
    said = capsys.readouterr().err.strip()
    assert "written by another program (sources others, here " in said
    assert len(said.splitlines()) == 1


def test_an_item_of_another_program_is_named_and_made_again(folder: Path, whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "data")
    item = tmp_path / "data/items/000001/item.json"
    facts = json.loads(item.read_text())
    item.write_text(json.dumps(facts | {"program": facts["program"] | {"sources": "others"}}))
    command = ["dataset", str(folder / "dataset.toml"), "-o", str(tmp_path / "data"), "--workers", "0", "--count", "3"]
    assert main(command) == 0
    assert json.loads(item.read_text())["program"] == facts["program"]
    assert "another program (sources others" in (tmp_path / "data/log.jsonl").read_text()
    assert (tmp_path / "data/index.jsonl").read_bytes() == (whole / "index.jsonl").read_bytes()


def test_a_dry_run_warns_of_what_the_check_of_an_item_warns_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = small_scene(samples=4, replicates=2, wavelengths_nm=[20_000.0])
    (tmp_path / "scene.toml").write_text(scene.dump_toml())
    draw = f'[[random]]\npath = "{DEPTH}"\nuniform = [-70.0, -50.0]\n'
    (tmp_path / "data.toml").write_text(f'scene = "scene.toml"\ncount = 1\nparts = []\n{draw}')
    for words in (["check", str(tmp_path / "scene.toml")], ["dataset", str(tmp_path / "data.toml"), "--dry-run"]):
        assert main(words) == 0
        said = capsys.readouterr()
        assert "diffraction is not traced" in " ".join((said.err + said.out).split())


def test_a_dry_run_lists_and_writes_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dataset", str(folder / "dataset.toml"), "-o", str(folder / "none"), "--count", "2", "--dry-run"]) == 0
    assert "textures/" in capsys.readouterr().out
    assert not (folder / "none").exists()


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        ({"path": DEPTH}, "nothing to draw from is given"),
        ({"path": DEPTH, "uniform": (2.0, 1.0)}, "is empty"),
        ({"path": DEPTH, "uniform": (1.0, 2.0), "values": [1.0]}, "values and uniform are given"),
        ({"path": DEPTH, "normal": (1.0, 0.0)}, "must be above 0"),
        ({"path": "targets[1].position_mm[2]", "uniform": (1.0, 2.0)}, "there is no [1]"),
        ({"path": TEXTURE, "files": "*.nothing"}, "there is no such file"),
        ({"path": TEXTURE, "files": "*.png", "relative": True}, "only numbers"),
        ({"path": "name", "uniform": (0.0, 1.0), "relative": True}, "not a number to add to"),
        ({"path": "targets[0].material.reflectance", "uniform": (2.0, 3.0)}, "item 0"),
        ({"path": "camera.mla.pitch_mm", "values": [-1.0]}, "item 1"),
    ],
)
def test_what_cannot_be_drawn_is_said_in_a_line(draw: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(lf.LfmeshError) as error:
        lf.Dataset(small_scene(), [draw], folder=tmp_path, count=2)
    assert message in str(error.value)


def test_a_file_that_is_no_picture_is_named_before_anything_is_rendered(tmp_path: Path) -> None:
    (tmp_path / "broken.png").write_text("no picture")
    with pytest.raises(lf.LfmeshError, match=r"item 0 .*broken\.png"):
        lf.Dataset(small_scene(), [{"path": TEXTURE, "files": "*.png"}], folder=tmp_path, count=1)


def test_items_and_cameras_whose_pictures_may_be_wrong_are_warned_of(tmp_path: Path) -> None:
    """The white image of a camera is shared: it has a warning of its own, whichever items use it."""
    random = [{"path": "transport.max_events", "values": [2, 6]}]
    dataset = lf.Dataset(small_scene(samples=32, replicates=2), random, count=3, seed=1, parts=["white"])
    cut = [number for number in range(3) if dataset.drawn(number)["transport.max_events"] == 2]
    assert 0 < len(cut) < 3
    with pytest.warns(lf.CutPathsWarning) as told:
        made = dataset.make(tmp_path, workers=0)
    assert tuple(each.message for each in told) == made.warnings
    # With two events a picture is black, too.
    for kind in (lf.BlackPictureWarning, lf.CutPathsWarning):
        assert [str(each).partition(":")[0] for each in made.warnings if type(each) is kind] == [
            f"{len(cut)} of 3 items, such as item {cut[0]}",
            f"1 of 2 cameras, such as {index_of(tmp_path)[cut[0]]['camera']}",
        ]
    assert {type(each) for each in made.warnings} == {lf.BlackPictureWarning, lf.CutPathsWarning}
    kinds = [[each["kind"] for each in line.get("warnings", [])] for line in index_of(tmp_path)]
    assert [number for number in range(3) if "CutPathsWarning" in kinds[number]] == cut
