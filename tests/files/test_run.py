"""Run folders: whole or not at all, and what is read back is what was saved."""

import json
import math
import os
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import PIL.Image
import pytest

import lfmesh as lf
from lfmesh.errors import FileError
from lfmesh.files import run
from lfmesh.scene import Scene, first_order, load
from lfmesh.transport.checks.aim_proof import AimProof, Missed
from lfmesh.transport.checks.found import found
from lfmesh.transport.checks.order_check import OrderCheck
from lfmesh.transport.render.certainty import Certainty
from lfmesh.view.request import subject_of
from tests.study.studies import small_scene

Build = Callable[..., lf.Image]


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_round_trip(image_of: Build, tmp_path: Path) -> None:
    image = image_of()
    run.save(image, tmp_path / "a" / "run")
    back = run.open_run(tmp_path / "a" / "run")
    np.testing.assert_array_equal(back.mean, image.mean.astype(np.float32))
    np.testing.assert_array_equal(back.stderr, image.stderr.astype(np.float32))
    assert back.mean.dtype == np.float64
    assert back.scene == image.scene
    assert back.scene.digest == image.scene.digest
    assert back.ledger == image.ledger
    assert (back.seconds, back.replicates, back.samples, back.engine) == (7.0, 8, 64.0, "mesh engine")
    assert back.complete
    assert back.hits is None
    assert back.order is None


def test_the_seconds_of_a_run_stand_in_the_header_of_its_image_and_in_its_report(tmp_path: Path) -> None:
    image = lf.render(small_scene(samples=1))
    spent = image.timings
    assert 0.0 < spent["thread_seconds"] <= spent["threads"] * spent["tracing_seconds"]
    assert spent["tracing_seconds"] == image.seconds
    run.save(image, tmp_path)
    assert run.open_run(tmp_path).timings == spent
    with OpenEXR.File(str(tmp_path / "raw.exr"), separate_channels=True) as file:
        header = json.loads(file.parts[0].header["lfmesh"])
    report = json.loads((tmp_path / "report.json").read_text())
    assert header["timings"] == report["timings"] == spent


def test_what_the_order_of_the_surfaces_was_compared_with_is_kept(image_of: Build, tmp_path: Path) -> None:
    image = image_of()
    image.order = OrderCheck(900, 300, 100, 2, 3e-10, 1e-13)
    run.save(image, tmp_path)
    assert run.open_run(tmp_path).order == image.order


def test_errors_and_bounds_made_by_part_are_kept(image_of: Build, tmp_path: Path) -> None:
    image = image_of()
    places = np.arange(image.mean.size, dtype=np.float64).reshape(image.mean.shape)
    image.certainty = Certainty(1.0 + places, 2.0 + places)
    run.save(image, tmp_path)
    back = run.open_run(tmp_path)
    np.testing.assert_array_equal(back.error, image.error)
    np.testing.assert_array_equal(back.upper, image.upper)


def test_hits_are_kept_as_whole_numbers_and_guarded_like_pixels(image_of: Build, tmp_path: Path) -> None:
    image = image_of()
    # More than a float32 counts to.
    image.hits = np.full(image.mean.shape, 2**24 + 1, np.uint32)
    image.hits[3, 5] = 0
    run.save(image, tmp_path)
    back = run.open_run(tmp_path).hits
    assert back is not None
    assert back.dtype == np.uint32
    np.testing.assert_array_equal(back, image.hits)
    with OpenEXR.File(str(tmp_path / "raw.exr"), separate_channels=True) as file:
        assert [part.name() for part in file.parts] == ["raw", "stderr", "hits"]
        file.parts[2].channels["S0.587,6nm"].pixels[0, 0] += 1
        file.write(str(tmp_path / "changed.exr"))
    (tmp_path / "changed.exr").replace(tmp_path / "raw.exr")
    with pytest.raises(FileError, match=r"raw\.exr is truncated or damaged: it is not what was saved"):
        run.open_run(tmp_path)
    # Without a manifest, as older versions wrote none, the pixels' own digest tells.
    (tmp_path / "manifest.json").unlink()
    with pytest.raises(FileError, match="pixels are not those that were saved"):
        run.open_run(tmp_path)


def test_a_run_holds_all_its_files_and_nothing_else(image_of: Build, tmp_path: Path) -> None:
    run.save(image_of(), tmp_path / "run")
    files = {"raw.exr", "preview.png", "preview_view.png", "linear16.png", "report.json", "scene.toml"}
    assert {path.name for path in (tmp_path / "run").iterdir()} == files | {"manifest.json"}
    assert set(json.loads((tmp_path / "run/manifest.json").read_text())["files"]) == files
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_conventional_camera_has_no_view_of_lenslets(image_of: Build, scene: Scene, tmp_path: Path) -> None:
    camera = scene.camera.model_copy(update={"mla": None})
    run.save(image_of(scene.model_copy(update={"camera": camera})), tmp_path / "run")
    assert not (tmp_path / "run/preview_view.png").exists()


def test_others_read_the_raw_image_as_it_lies_and_pictures_upright(image_of: Build, tmp_path: Path) -> None:
    image = image_of()
    image.mean[3, 5] = 9e-12
    run.save(image, tmp_path)
    with OpenEXR.File(str(tmp_path / "raw.exr"), separate_channels=True) as file:
        pixels = file.parts[0].channels["S0.587,6nm"].pixels.copy()
        metadata = json.loads(file.parts[0].header["lfmesh"])
    assert np.unravel_index(pixels.argmax(), pixels.shape) == (3, 5)
    assert metadata["scene_digest"] == image.scene.digest
    assert metadata["ledger"]["absorbed"] == {"stop": 1.25, "targets[0]": 0.5}
    assert metadata["seed"] == 0
    assert metadata["complete"] is True
    with PIL.Image.open(tmp_path / "linear16.png") as picture:
        counts = np.array(picture)
    scale = json.loads((tmp_path / "report.json").read_text())["pictures"]["linear16.png"]["watts_per_count"]
    # The lens of this camera inverts: columns of the sensor are reversed, rows are not.
    np.testing.assert_allclose(counts * scale, image.mean[:, ::-1, 0], atol=0.5001 * scale)
    assert metadata["orientation"].startswith("as on the sensor")
    assert "columns reversed, [:, ::-1]" in metadata["orientation"]
    with PIL.Image.open(tmp_path / "preview.png") as picture:
        assert np.corrcoef(np.array(picture).ravel(), image.mean[:, ::-1, 0].clip(0.0, 2e-12).ravel())[0, 1] > 0.99


def test_the_view_is_upright(image_of: Build, tmp_path: Path) -> None:
    """Light on the lenslets at +x, +y of the sensor comes from −x, −y, which belongs bottom left."""
    image = image_of()
    image.mean[:] = 1e-15
    image.mean[40:, 60:] = 1e-12
    run.save(image, tmp_path)
    with PIL.Image.open(tmp_path / "preview_view.png") as picture:
        view = np.array(picture, dtype=float)
    assert max(view.shape) == 640
    quarters = (
        view[:320, :320].mean(),
        view[:320, 320:].mean(),
        view[320:, :320].mean(),
        view[320:, 320:].mean(),
    )
    assert np.argmax(quarters) == 2


def test_the_saved_scene_renders_again_from_the_run_folder(image_of: Build, scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "project").mkdir()
    PIL.Image.new("L", (4, 4)).save(tmp_path / "project/chart.png")
    textured = scene.changed({"targets[0].material.texture": "chart.png"}).in_folder(tmp_path / "project")
    run.save(image_of(textured), tmp_path / "runs/first")
    again = load(tmp_path / "runs/first/scene.toml")
    texture = again.targets[0].material.texture
    assert texture is not None
    assert again.resolve(texture) == tmp_path / "runs/first/inputs/chart.png"
    assert again.resolve(texture).read_bytes() == (tmp_path / "project/chart.png").read_bytes()
    back = run.open_run(tmp_path / "runs/first").scene
    assert back == again
    assert back.changed({"targets[0].material.texture": "chart.png"}) == textured
    assert back.folder == tmp_path / "runs/first"


def test_a_run_opens_without_its_meshes_and_textures(image_of: Build, scene: Scene, tmp_path: Path) -> None:
    run.save(image_of(scene.changed({"targets[0].material.texture": "gone.png"})), tmp_path)
    texture = run.open_run(tmp_path).scene.targets[0].material.texture
    assert texture is not None
    assert Path(texture).name == "gone.png"


def test_an_interrupted_run_is_valid_and_marked(image_of: Build, tmp_path: Path) -> None:
    proven = AimProof(45_000, Missed(0.0, 2e-5), Missed(0.0, 2e-5), fitted=0)
    image = image_of(replicates=1, samples=8.0, aim=proven)
    image.stderr[:] = math.nan
    image.warnings = tuple(found(image))
    run.save(image, tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["complete"] is False
    assert (report["replicates_finished"], report["replicates"]) == (1, 8)
    assert report["noise"]["relative_error"] is None
    back = run.open_run(tmp_path)
    assert not back.complete
    assert np.isnan(back.stderr).all()
    (warning,) = back.warnings
    assert isinstance(warning, lf.InterruptedRenderWarning)
    assert "interrupted after 1 of 8 replicates, 8 samples per pixel. The picture is noisier" in str(warning)
    assert "its errors are unknown" in str(warning)
    assert not found(image_of(aim=proven))


def test_the_report_holds_the_airy_disks(image_of: Build, scene: Scene, tmp_path: Path) -> None:
    run.save(image_of(scene.changed({"transport.wavelengths_nm": [486.1, 587.6, 656.3]})), tmp_path)
    diffraction = json.loads((tmp_path / "report.json").read_text())["diffraction"]
    pixel, lenslet = scene.camera.sensor.pixel_mm, scene.camera.mla.pitch_mm
    facts = first_order(scene)
    assert diffraction["airy_wavelength_nm"] == 656.3
    assert diffraction["airy_disk_mm"] == pytest.approx(2.43934 * 656.3e-6 * facts.working_f_number, rel=1e-6)
    assert diffraction["airy_disk_samples"] == pytest.approx(diffraction["airy_disk_mm"] / lenslet, rel=1e-12)
    of_lenslet = 2.43934 * 656.3e-6 * facts.microlens_f_number / pixel
    assert diffraction["microlens_airy_disk_px"] == pytest.approx(of_lenslet, rel=1e-6)


def test_a_report_of_before_losses_were_booked_by_body_opens(image_of: Build) -> None:
    older = image_of().ledger.as_dict()
    del older["lost_in"]
    assert lf.Ledger.from_dict(older).lost_in == {}


def test_a_new_run_replaces_the_old_one_and_leaves_other_files(image_of: Build, scene: Scene, tmp_path: Path) -> None:
    run.save(image_of(scene.changed({"transport.wavelengths_nm": [486.1, 587.6, 656.3]})), tmp_path)
    assert (tmp_path / "linear16_486.1nm.png").exists()
    (tmp_path / "notes.txt").write_text("mine")
    run.save(image_of(seconds=9.0), tmp_path)
    assert run.open_run(tmp_path).seconds == 9.0
    assert not (tmp_path / "linear16_486.1nm.png").exists()
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("file", ["manifest.json", "report.json"])
def test_no_file_can_make_save_delete_outside_its_folder(image_of: Build, tmp_path: Path, file: str) -> None:
    run.save(image_of(), tmp_path / "run")
    (tmp_path / "precious.txt").write_text("keep")
    (tmp_path / "run/inputs").mkdir()
    document = json.loads((tmp_path / "run" / file).read_text())
    names = ["../precious.txt", str(tmp_path / "precious.txt"), "..", "inputs/../../precious.txt"]
    if file == "report.json":
        # As in runs of before there were manifests.
        (tmp_path / "run/manifest.json").unlink()
        document["files"] = names
    else:
        document["files"] |= {name: {"bytes": 4, "sha256": "0" * 64} for name in names}
    (tmp_path / "run" / file).write_text(json.dumps(document))
    run.save(image_of(), tmp_path / "run")
    assert (tmp_path / "precious.txt").read_text() == "keep"


def test_a_folder_with_other_things_is_refused_and_untouched(image_of: Build, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    before = snapshot(tmp_path)
    for act in (lambda: run.prepare(tmp_path), lambda: run.save(image_of(), tmp_path)):
        with pytest.raises(FileError, match=r"holds thesis\.tex and no run"):
            act()
    assert snapshot(tmp_path) == before


def test_prepare_leaves_nothing_behind(tmp_path: Path) -> None:
    run.prepare(tmp_path / "a" / "b" / "c")
    assert list(tmp_path.iterdir()) == []


def test_unwritable_places_are_refused(image_of: Build, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for place, message in (
        (tmp_path / "file", "is a file"),
        (tmp_path / "file" / "run", "cannot be written"),
    ):
        with pytest.raises(FileError, match=message):
            run.prepare(place)
        with pytest.raises(FileError, match=message):
            run.save(image_of(), place)
    if os.geteuid() != 0:
        (tmp_path / "locked").mkdir(mode=0o500)
        with pytest.raises(FileError, match="cannot be written: Permission denied"):
            run.prepare(tmp_path / "locked" / "run")


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt, OSError(28, "No space left on device")], ids=["ctrl-c", "disk full"]
)
@pytest.mark.parametrize("old", [False, True], ids=["new folder", "over an old run"])
def test_a_failure_while_saving_leaves_everything_as_it_was(
    image_of: Build,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    error: type[BaseException] | OSError,
    old: bool,
) -> None:
    if old:
        run.save(image_of(), tmp_path / "deep/run")
    before = snapshot(tmp_path)

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(run, "write_linear16", fail)
    with pytest.raises(FileError if isinstance(error, OSError) else KeyboardInterrupt):
        run.save(image_of(seconds=1.0), tmp_path / "deep/run")
    assert snapshot(tmp_path) == before
    assert old or list(tmp_path.iterdir()) == []


def test_damage_is_noticed(image_of: Build, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="does not exist"):
        run.open_run(tmp_path / "none")
    with pytest.raises(FileError, match=r"raw\.exr and report\.json missing"):
        run.open_run(tmp_path)
    run.save(image_of(), tmp_path)
    raw, report = (tmp_path / "raw.exr").read_bytes(), (tmp_path / "report.json").read_text()

    (tmp_path / "raw.exr").write_bytes(raw[: len(raw) // 2])
    with pytest.raises(FileError, match=r"raw\.exr is truncated or damaged"):
        run.open_run(tmp_path)
    (tmp_path / "raw.exr").write_bytes(raw)

    (tmp_path / "report.json").write_text(report[:100])
    with pytest.raises(FileError, match=r"report\.json is damaged"):
        run.open_run(tmp_path)

    (tmp_path / "report.json").write_text(report.replace('"format": 2', '"format": 7'))
    with pytest.raises(FileError, match=r"run format 7.* reads format 2$"):
        run.open_run(tmp_path)

    other = image_of()
    other.mean *= 2.0
    run.save(other, tmp_path / "other")
    (tmp_path / "report.json").write_text((tmp_path / "other/report.json").read_text())
    with pytest.raises(FileError, match="mixes two runs"):
        run.open_run(tmp_path)


def test_runs_with_mirrored_pictures_are_refused_with_the_reason_and_replaced(image_of: Build, tmp_path: Path) -> None:
    run.save(image_of(), tmp_path)
    report = (tmp_path / "report.json").read_text()
    (tmp_path / "report.json").write_text(report.replace('"format": 2', '"format": 1'))
    for read in (run.open_run, run.pixels_digest, subject_of):
        with pytest.raises(
            FileError, match=r"format 1, .* are mirror images .* render its scene\.toml again"
        ) as caught:
            read(tmp_path)
        assert "\n" not in str(caught.value)
    run.save(image_of(seconds=9.0), tmp_path)
    assert run.open_run(tmp_path).seconds == 9.0


def test_pixels_changed_by_another_program_are_noticed(image_of: Build, tmp_path: Path) -> None:
    run.save(image_of(), tmp_path)
    with OpenEXR.File(str(tmp_path / "raw.exr"), separate_channels=True) as file:
        file.parts[0].channels["S0.587,6nm"].pixels[0, 0] *= 1.001
        file.write(str(tmp_path / "changed.exr"))
    (tmp_path / "changed.exr").replace(tmp_path / "raw.exr")
    with pytest.raises(FileError, match=r"raw\.exr is truncated or damaged: it is not what was saved"):
        run.open_run(tmp_path)
    # Without a manifest, as older versions wrote none, the pixels' own digest tells.
    (tmp_path / "manifest.json").unlink()
    with pytest.raises(FileError, match="pixels are not those that were saved"):
        run.open_run(tmp_path)


def test_saving_copies_a_large_film_few_times(image_of: Build, tmp_path: Path) -> None:
    peaks, sides = [], (300, 900)
    for side in sides:
        film = np.random.default_rng(1).uniform(0.5, 1.0, (side, side, 1))
        image = replace(image_of(), mean=film, stderr=0.01 * film)
        tracemalloc.start()
        try:
            run.save(image, tmp_path / "run")
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    # Mean and standard error as float32 are one film; the noise's median needs two, and masks of a byte a pixel.
    assert peaks[1] - peaks[0] < 3.0 * 8 * (sides[1] ** 2 - sides[0] ** 2)


def test_an_image_is_shown_in_one_short_line(image_of: Build) -> None:
    shown = repr(image_of())
    assert shown.startswith("<Image: 80 × 60 pixels, 1 wavelength, 8 of 8 replicates, 64 samples per pixel, ")
    assert len(shown) < 150


@pytest.mark.parametrize(("name", "why"), [("nowhere", "it does not exist"), ("x" * 300, "File name too long")])
def test_a_name_that_no_folder_has_or_can_have_is_refused(name: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(FileError, match=f"is not a run folder: {why}"):
        run.open_run(tmp_path / name)
