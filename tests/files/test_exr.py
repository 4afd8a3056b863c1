"""Raw images in OpenEXR: exact, readable by others, and every damage noticed."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from lfmesh.errors import FileError
from lfmesh.files import exr

WAVELENGTHS = (450.0, 587.5618, 1014.0)
PARTS = ("raw", "stderr")


def spectral_image(seed: int = 0, wavelengths: tuple[float, ...] = WAVELENGTHS) -> exr.SpectralImage:
    rng = np.random.default_rng(seed)
    shape = (23, 31, len(wavelengths))
    raw = rng.random(shape, dtype=np.float32) * np.float32(1e-13)
    return exr.SpectralImage(
        {"raw": raw, "stderr": raw / 7}, wavelengths, {"third": 1 / 3, "text": "µ \n é", "list": [1, None]}
    )


def test_round_trip_is_exact(tmp_path: Path) -> None:
    image = spectral_image()
    exr.write(tmp_path / "a.exr", image)
    back = exr.read(tmp_path / "a.exr", PARTS)
    assert back.wavelengths_nm == WAVELENGTHS
    assert back.metadata == image.metadata
    for name in PARTS:
        assert back.parts[name].dtype == np.float32
        np.testing.assert_array_equal(back.parts[name], image.parts[name])


def test_openexr_itself_reads_parts_channels_and_metadata(tmp_path: Path) -> None:
    image = spectral_image()
    exr.write(tmp_path / "a.exr", image)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        assert [part.name() for part in file.parts] == ["raw", "stderr"]
        assert [part.compression() for part in file.parts] == [OpenEXR.ZIP_COMPRESSION] * 2
        names = ["S0.450,0nm", "S0.587,5618nm", "S0.1014,0nm"]  # Fichet et al. 2021
        for part in file.parts:
            assert set(part.channels) == set(names)
            for c, name in enumerate(names):
                np.testing.assert_array_equal(part.channels[name].pixels, image.parts[part.name()][:, :, c])
        assert json.loads(file.parts[0].header["lfmesh"])["third"] == 1 / 3


@pytest.mark.parametrize(
    "view",
    [
        lambda a: a[::-1, ::-1],
        lambda a: a.transpose(1, 0, 2),
        lambda a: a[::2, 1::3],
        lambda a: a.astype(np.float64),
    ],
    ids=["reversed", "transposed", "strided", "float64"],
)
def test_memory_layout_does_not_matter(tmp_path: Path, view: object) -> None:
    assert callable(view)
    raw = view(spectral_image().parts["raw"])
    exr.write(tmp_path / "a.exr", exr.SpectralImage({"raw": raw}, WAVELENGTHS, {}))
    np.testing.assert_array_equal(exr.read(tmp_path / "a.exr", ("raw",)).parts["raw"], raw.astype(np.float32))


def test_nan_survives(tmp_path: Path) -> None:
    stderr = np.full((4, 5, 1), np.nan, dtype=np.float32)
    exr.write(tmp_path / "a.exr", exr.SpectralImage({"raw": stderr}, (550.0,), {}))
    assert np.isnan(exr.read(tmp_path / "a.exr", ("raw",)).parts["raw"]).all()


@pytest.mark.parametrize("share", [0.0, 0.01, 0.1, 0.5, 0.75, 0.98])
def test_truncation_is_noticed(tmp_path: Path, share: float, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.exr"
    exr.write(path, spectral_image())
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(FileError, match=r"a\.exr.* truncated"):
        exr.read(path, PARTS)
    assert capsys.readouterr().out == ""


def test_every_byte_counts_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    exr.write(path, spectral_image())
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(FileError, match="truncated or damaged"):
        exr.read(path, PARTS)


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="does not exist"):
        exr.read(tmp_path / "none.exr", PARTS)
    (tmp_path / "text.exr").write_bytes(b"no picture at all " * 100)
    with pytest.raises(FileError, match="not a readable OpenEXR file"):
        exr.read(tmp_path / "text.exr", PARTS)
    foreign = OpenEXR.Part({}, {"Y": np.zeros((3, 4), np.float32)}, "raw")
    OpenEXR.File([foreign]).write(str(tmp_path / "foreign.exr"))
    with pytest.raises(FileError, match="not written by lfmesh"):
        exr.read(tmp_path / "foreign.exr", ("raw",))


def test_equal_wavelengths_and_bad_places_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="every wavelength must differ"):
        exr.write(tmp_path / "a.exr", spectral_image(wavelengths=(550.0, 550.0)))
    with pytest.raises(FileError, match="cannot be written"):
        exr.write(tmp_path / "no such folder" / "a.exr", spectral_image())
