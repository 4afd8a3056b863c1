"""What decoding and refocusing add to a run folder: it reads back, and belongs to the run or goes with it."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import PIL.Image
import pytest

import lfmesh as lf
from lfmesh.files import exr, photographs, run
from lfmesh.files.field import FIELD, PARTS, open_field, save_field
from lfmesh.files.folder import MANIFEST
from lfmesh.lightfield.photographs.photograph import all_in_focus


@pytest.fixture
def folder(image_of: Callable[..., lf.Image], tmp_path: Path) -> Path:
    return lf.save(image_of(), tmp_path / "run")


@pytest.fixture
def white(image_of: Callable[..., lf.Image]) -> lf.Image:
    image = image_of()
    return replace(image, scene=image.scene.changed({"name": "white"}))


def files_of(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_light_field_reads_back_as_it_was(folder: Path, white: lf.Image) -> None:
    field = lf.decode(lf.open_run(folder), white=white)
    data = field.data.copy()
    data[1, 2, 3] = np.nan
    field = replace(field, data=data)
    save_field(field, folder)
    again = open_field(folder)
    assert again is not None
    for name in ("data", "stderr", "sharing", "v_rad", "u_rad", "t_mm", "s_mm"):
        np.testing.assert_array_equal(getattr(again, name), getattr(field, name))
    for name in ("wavelengths_nm", "unit", "scene", "sampling"):
        assert getattr(again, name) == getattr(field, name)
    assert again.model == field.model


def test_the_manifest_lists_what_was_added_and_the_run_stays_a_run(folder: Path, white: lf.Image) -> None:
    before = lf.open_run(folder)
    save_field(lf.decode(before), folder)
    lf.save_white(white, lf.calibrate(white.scene), folder)
    listed = json.loads((folder / MANIFEST).read_text())["files"]
    assert {*listed, MANIFEST} == files_of(folder)
    for name, entry in listed.items():
        contents = (folder / name).read_bytes()
        assert entry == {"bytes": len(contents), "sha256": hashlib.sha256(contents).hexdigest()}
    np.testing.assert_array_equal(lf.open_run(folder).mean, before.mean)


def test_rendering_anew_takes_away_what_belonged_to_the_old_image(
    folder: Path, white: lf.Image, image_of: Callable[..., lf.Image]
) -> None:
    (folder / "notes.txt").write_text("mine")
    plain = files_of(folder)
    image = lf.open_run(folder)
    lf.save_white(white, lf.calibrate(white.scene), folder)
    field = lf.decode(image)
    save_field(field, folder)
    stack = lf.focal_stack(field, [450.0, 500.0, 550.0])
    photographs.save_stack(stack, folder)
    photographs.save_all_in_focus(all_in_focus(stack), folder)
    photographs.save_photograph(stack.photographs[0], folder)
    assert len(files_of(folder)) >= len(plain) + 11
    lf.save(image_of(seconds=8.0), folder)
    assert files_of(folder) == plain


def test_a_light_field_of_another_image_is_not_taken_for_this_ones(folder: Path) -> None:
    image = lf.open_run(folder)
    save_field(lf.decode(image), folder)
    kept = (folder / FIELD).read_bytes()
    lf.save(replace(image, mean=2.0 * image.mean), folder)
    (folder / FIELD).write_bytes(kept)
    assert open_field(folder) is None


def test_a_white_image_reads_back(folder: Path, white: lf.Image) -> None:
    assert lf.open_white(folder) is None
    lf.save_white(white, lf.calibrate(white.scene), folder)
    again = lf.open_white(folder)
    assert again is not None
    np.testing.assert_allclose(again.mean, white.mean, rtol=1e-6)
    assert again.scene == white.scene


def test_photographs_hold_their_planes_and_errors(folder: Path) -> None:
    field = lf.decode(lf.open_run(folder))
    stack = lf.focal_stack(field, [450.0, 500.0, 550.0], f_number=8.0)
    (exr, png) = photographs.save_photograph(stack.photographs[1], folder)
    assert exr.name == "refocused_500mm.exr"
    with OpenEXR.File(str(exr), separate_channels=True) as file:
        parts = {part.name(): np.array(next(iter(part.channels.values())).pixels) for part in file.parts}
        facts = json.loads(file.parts[0].header["lfmesh"])
    np.testing.assert_array_equal(parts["mean"], stack.photographs[1].mean[..., 0].astype(np.float32))
    np.testing.assert_array_equal(parts["stderr"], stack.photographs[1].stderr[..., 0].astype(np.float32))
    assert (facts["distance_mm"], facts["f_number"], facts["orientation"]) == (500.0, 8.0, "upright")
    with PIL.Image.open(png) as picture:
        assert picture.height / picture.width == pytest.approx(field.size[0] / field.size[1], rel=0.01)


def test_a_stack_is_an_animation_there_and_back(folder: Path) -> None:
    stack = lf.focal_stack(lf.decode(lf.open_run(folder)), [450.0, 500.0, 550.0, 600.0])
    exr, png = photographs.save_stack(stack, folder)
    with OpenEXR.File(str(exr), separate_channels=True) as file:
        assert [part.name() for part in file.parts] == ["450 mm", "500 mm", "550 mm", "600 mm"]
    with PIL.Image.open(png) as picture:
        assert picture.n_frames == 6


def test_damage_and_other_versions_are_told_in_one_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    field = lf.decode(lf.open_run(folder))
    save_field(field, folder)
    whole = (folder / FIELD).read_bytes()
    with monkeypatch.context() as older:
        older.setattr("lfmesh.files.field.FORMAT", 1)
        save_field(field, folder)
    with pytest.raises(
        lf.FileError, match=r"light field format 1; .* mirror images .* decode the run again$"
    ) as caught:
        open_field(folder)
    assert "\n" not in str(caught.value)
    (folder / FIELD).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(lf.FileError, match="truncated or damaged") as caught:
        open_field(folder)
    assert "\n" not in str(caught.value)
    (folder / run.RAW).unlink()
    with pytest.raises(lf.FileError, match=r"not a complete run: raw\.exr missing"):
        save_field(field, folder)
    assert not [name for name in files_of(folder) if name.startswith(".lfmesh")]


@pytest.mark.parametrize("values", [[0.0], [[0.0]], "missing", None, "text"])
def test_axes_that_do_not_fit_the_views_are_refused(folder: Path, values: Any) -> None:
    save_field(lf.decode(lf.open_run(folder)), folder)
    spectral = exr.read(folder / FIELD, PARTS)
    metadata = {key: value for key, value in (spectral.metadata | {"s_mm": values}).items() if value != "missing"}
    exr.write(folder / FIELD, exr.SpectralImage(spectral.parts, spectral.wavelengths_nm, metadata))
    (folder / "manifest.json").unlink()
    with pytest.raises(lf.FileError, match=r"lightfield\.exr is damaged: .* decode the run again$") as caught:
        open_field(folder)
    assert "\n" not in str(caught.value)


def test_a_failure_while_adding_leaves_the_run_as_it_was(folder: Path) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def fail() -> None:
        with run.added(folder) as staging:
            (staging / "lightfield.exr").write_bytes(b"half")
            raise lf.FileError("the disk is full")

    with pytest.raises(lf.FileError, match="the disk is full"):
        fail()
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
