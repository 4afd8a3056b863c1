"""A damaged run is refused by one line that names the file, wherever the damage is and even if digests match it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import FileError
from lfmesh.files import exr, run

Build = Callable[..., lf.Image]


def why_refused(folder: Path) -> str | None:
    try:
        run.open_run(folder)
    except FileError as error:
        return str(error)
    return None


def refusal(folder: Path) -> str:
    with pytest.raises(FileError) as raised:
        run.open_run(folder)
    message = str(raised.value)
    assert len(message.splitlines()) == 1
    assert len(message) < 500 + len(str(folder))
    return message


def written_anew(folder: Path, image: lf.Image, **changes: Any) -> None:
    """Write raw.exr with other metadata, its pixels' digest fitting: what another program could have made."""
    run.save(image, folder)
    change_metadata(folder, exr.read(folder / "raw.exr", ("raw", "stderr")), changes)


def change_metadata(folder: Path, spectral: exr.SpectralImage, changes: dict[str, Any]) -> None:
    """Write the raw.exr of a run with some metadata changed; "missing" leaves one out."""
    metadata = spectral.metadata | {"wavelengths_nm": list(spectral.wavelengths_nm)} | changes
    metadata = {key: value for key, value in metadata.items() if value != "missing"}
    exr.write(folder / "raw.exr", exr.SpectralImage(spectral.parts, spectral.wavelengths_nm, metadata))
    (folder / "manifest.json").unlink(missing_ok=True)


def test_a_run_written_anew_without_changes_opens(image_of: Build, tmp_path: Path) -> None:
    """Else the changes below might be refused for another reason."""
    written_anew(tmp_path, image_of())
    assert run.open_run(tmp_path).mean.shape == image_of().mean.shape


@pytest.mark.parametrize(
    ("part", "value"),
    [("mean", np.nan), ("mean", np.inf), ("mean", -1e-15), ("stderr", np.inf), ("stderr", -1e-15)],
)
def test_pixels_that_no_render_gives_are_refused_though_their_digest_fits(
    image_of: Build, tmp_path: Path, part: str, value: float
) -> None:
    image = image_of()
    getattr(image, part)[3, 5] = value
    run.save(image, tmp_path)
    message = refusal(tmp_path)
    assert str(tmp_path / "raw.exr") in message
    assert "negative" in message


def test_an_error_that_one_replicate_does_not_tell_is_read(image_of: Build, tmp_path: Path) -> None:
    image = image_of()
    image.stderr[:] = np.nan
    run.save(image, tmp_path)
    assert np.isnan(run.open_run(tmp_path).stderr).all()


def test_a_picture_of_another_size_than_the_sensor_is_refused(image_of: Build, tmp_path: Path) -> None:
    run.save(image_of(mean=np.ones((6, 8, 1)), stderr=np.ones((6, 8, 1))), tmp_path)
    assert "its scene's sensor has (60, 80, 1)" in refusal(tmp_path)


KEYS = ("ledger", "seconds", "replicates_finished", "samples_per_pixel", "engine", "scene_toml", "scene_folder")
STRANGE = ["missing", None, [], {}, "text", True, -1, [[[1]]]]


@pytest.mark.parametrize("key", KEYS)
def test_strange_metadata_is_refused_or_read(image_of: Build, tmp_path: Path, key: str) -> None:
    refused = 0
    run.save(image_of(), tmp_path)
    saved = exr.read(tmp_path / "raw.exr", ("raw", "stderr"))
    for value in STRANGE:
        change_metadata(tmp_path, saved, {key: value})
        message = why_refused(tmp_path)
        refused += message is not None
        assert message is None or message.startswith(str(tmp_path / "raw.exr"))
        assert message is None or len(message.splitlines()) == 1
    assert refused > len(STRANGE) / 2


@pytest.mark.parametrize("key", ["refinement", "aim", "blind", "order", "coatings", "timings", "inputs"])
def test_strange_optional_metadata_is_refused(image_of: Build, tmp_path: Path, key: str) -> None:
    written_anew(tmp_path, image_of(), **{key: [1, 2]})
    assert "raw.exr" in refusal(tmp_path)


@pytest.mark.parametrize("wavelengths_nm", [None, 3, "587.6", [], [None], [[1]], [1.0], {}])
def test_strange_wavelengths_are_refused(image_of: Build, tmp_path: Path, wavelengths_nm: Any) -> None:
    run.save(image_of(), tmp_path)
    content = (tmp_path / "raw.exr").read_bytes()
    attribute = b'"wavelengths_nm": [587.6]'
    assert content.count(attribute) == 1
    other = f'"wavelengths_nm":{json.dumps(wavelengths_nm)}'.encode()
    (tmp_path / "raw.exr").write_bytes(content.replace(attribute, other.ljust(len(attribute))))
    (tmp_path / "manifest.json").unlink()
    assert "raw.exr" in refusal(tmp_path)


def test_a_list_of_files_that_is_none_is_no_list(image_of: Build, tmp_path: Path) -> None:
    for files in (None, 3, {"a": 1}, ["raw.exr", None, 4]):
        run.save(image_of(), tmp_path)
        report = json.loads((tmp_path / "report.json").read_text())
        (tmp_path / "report.json").write_text(json.dumps(report | {"files": files}))
        (tmp_path / "manifest.json").unlink()
        run.save(image_of(seconds=9.0), tmp_path)
        assert run.open_run(tmp_path).seconds == 9.0


def test_one_file_copied_over_another_is_noticed(image_of: Build, tmp_path: Path) -> None:
    run.save(image_of(), tmp_path / "run")
    other = image_of()
    other.mean *= 2.0
    run.save(other, tmp_path / "other")
    names = ("raw.exr", "report.json", "manifest.json")
    for source in ("run", "other"):
        for name in names:
            for target in names:
                if (source, name) == ("run", target):
                    continue
                copy = tmp_path / "copy"
                shutil.copytree(tmp_path / "run", copy)
                shutil.copy(tmp_path / source / name, copy / target)
                assert "copy" in refusal(copy)
                shutil.rmtree(copy)


def test_a_manifest_that_names_no_image_is_refused(image_of: Build, tmp_path: Path) -> None:
    run.save(image_of(), tmp_path)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    del manifest["files"]["raw.exr"]
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    assert "does not name raw.exr" in refusal(tmp_path)
