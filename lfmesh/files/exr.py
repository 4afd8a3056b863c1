"""Spectral images in OpenEXR: several parts, one channel per wavelength, and exact metadata as JSON."""

import errno
import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from lfmesh.errors import FileError
from lfmesh.files.json_values import parse_json
from lfmesh.regular_file import why_no_file
from lfmesh.scene.camera.bands import channel_labels

METADATA = "lfmesh"
"""Attribute of the first part that holds the metadata as JSON: EXR floats are float32, and its lists get lost."""


@dataclass(frozen=True)
class SpectralImage:
    """Content of an EXR file.

    Attributes
    ----------
    parts : dict of (H, W, wavelengths) float32, or uint32 for counts
    wavelengths_nm : tuple of float
        One per channel of every part; bands' `Centroids` also name the channels.
    metadata : dict
        Plain JSON values.
    """

    parts: dict[str, NDArray[Any]]
    wavelengths_nm: tuple[float, ...]
    metadata: dict[str, Any]


def channel_name(wavelength_nm: float) -> str:
    """Return the channel name of a wavelength, e.g. ``S0.550,0nm``.

    S0 is the first Stokes component; the comma is the decimal sign, as a dot would open a new layer: A. Fichet, R.
    Pacanowski, A. Wilkie, "An OpenEXR Layout for Spectral Images", JCGT 10(3), 2021.
    """
    return f"S0.{float(wavelength_nm)!r}nm".replace(".", ",").replace(",", ".", 1)


def write(path: Path, image: SpectralImage) -> None:
    """Write losslessly (ZIP; float32, counts as uint32).

    Raises
    ------
    FileError
        The file cannot be written, or two wavelengths are equal.
    """
    labels = list(channel_labels(image.wavelengths_nm))
    names = labels or [channel_name(wavelength) for wavelength in image.wavelengths_nm]
    if len(set(names)) != len(names):
        raise FileError(f"{path}: every wavelength must differ from the others, got {list(image.wavelengths_nm)}")
    metadata = {**image.metadata, "wavelengths_nm": list(image.wavelengths_nm)}
    if labels:
        metadata["bands"] = labels
    parts = []
    for number, (name, pixels) in enumerate(image.parts.items()):
        header: dict[str, Any] = {
            "compression": OpenEXR.ZIP_COMPRESSION,
            "type": OpenEXR.scanlineimage,
            "spectralLayoutVersion": "1.0",
        }
        if number == 0:
            header[METADATA] = json.dumps(metadata, allow_nan=False, ensure_ascii=True)
        # OpenEXR rejects float64 and silently corrupts strided arrays.
        stored = np.uint32 if np.issubdtype(pixels.dtype, np.integer) else np.float32
        channels = {channel: np.ascontiguousarray(pixels[:, :, c], dtype=stored) for c, channel in enumerate(names)}
        parts.append(OpenEXR.Part(header, channels, name))
    try:
        OpenEXR.File(parts).write(str(path))
    except (RuntimeError, OSError) as error:
        raise FileError(f"{path} cannot be written: {_reason(error)}") from None


def _reason(error: Exception) -> str:
    """Return the reason a write failed, without OpenEXR's repetition of the file name."""
    full = os.strerror(errno.ENOSPC)
    return full if full in str(error) else str(error)


def write_maps(path: Path, maps: Mapping[str, NDArray[np.floating]], metadata: Mapping[str, Any]) -> None:
    """Write (H, W) maps other than light, such as depth (channel Z by custom), as channels of one part.

    Parameters
    ----------
    path : Path
    maps : dict
        Arrays (H, W) by channel.
    metadata : dict
        JSON values.

    Raises
    ------
    FileError
        The file cannot be written.
    """
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        METADATA: json.dumps(dict(metadata), allow_nan=False, ensure_ascii=True),
    }
    channels = {name: np.ascontiguousarray(pixels, dtype=np.float32) for name, pixels in maps.items()}
    try:
        OpenEXR.File(header, channels).write(str(path))
    except (RuntimeError, OSError) as error:
        raise FileError(f"{path} cannot be written: {_reason(error)}") from None


def read(path: Path, part_names: Sequence[str], optional: Sequence[str] = ()) -> SpectralImage:
    """Read a file made by `write`.

    Parameters
    ----------
    path : Path
    part_names : sequence of str
        Required parts; the first carries the metadata.
    optional : sequence of str
        Read if present.

    Raises
    ------
    FileError
        The file is missing, truncated, not an EXR, or not written by lfmesh.
    """
    if not path.is_file():
        raise FileError(f"{path} {why_no_file(path)}")
    try:
        with _opened(path) as file:
            pixels = {
                part.name(): {name: channel.pixels.copy() for name, channel in part.channels.items()}
                for part in file.parts
            }
            headers = {part.name(): dict(part.header) for part in file.parts}
    except Exception:  # OpenEXR's readers may raise anything for a damaged file
        raise FileError(f"{path} is not a readable OpenEXR file: it is truncated, damaged or something else") from None
    missing = [name for name in part_names if name not in pixels]
    if missing:
        raise FileError(f"{path} is truncated or damaged: part {missing[0]!r} cannot be read")
    part_names = [*part_names, *(name for name in optional if name in pixels)]
    text = headers[part_names[0]].get(METADATA)
    if not isinstance(text, str):
        raise FileError(f"{path} was not written by lfmesh: its part {part_names[0]!r} has no attribute {METADATA!r}")
    metadata = _parse(path, text)
    wavelengths_nm = _numbers(path, metadata.pop("wavelengths_nm"))
    channels = _names(path, metadata.pop("bands", None)) or [channel_name(each) for each in wavelengths_nm]
    if any(set(pixels[name]) != set(channels) for name in part_names):
        raise FileError(f"{path} is damaged: its channels must be {', '.join(channels)}")
    shapes = {pixels[name][channel].shape for name in part_names for channel in channels}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise FileError(f"{path} is damaged: its channels differ in size")
    return SpectralImage(
        parts={name: np.stack([pixels[name][channel] for channel in channels], axis=2) for name in part_names},
        wavelengths_nm=wavelengths_nm,
        metadata=metadata,
    )


def read_map(path: Path, names: Sequence[str]) -> NDArray[np.float32]:
    """Read one (H, W) channel: the first of the given names present in the first part of an EXR.

    Raises
    ------
    FileError
        The file is missing, truncated, not an EXR, or has none of the channels.
    """
    if not path.is_file():
        raise FileError(f"{path} {why_no_file(path)}")
    try:
        with _opened(path) as file:
            channels = file.parts[0].channels if file.parts else {}
            found = next((name for name in names if name in channels), None)
            pixels = channels[found].pixels.astype(np.float32) if found is not None else None
    except Exception:  # as in read
        raise FileError(f"{path} is not a readable OpenEXR file: it is truncated, damaged or something else") from None
    if pixels is None:
        raise FileError(f"{path} has no channel {' or '.join(names)}")
    return np.asarray(pixels)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file for reading, hiding OpenEXR's messages about damage; truncated parts are left out."""
    with redirect_stdout(io.StringIO()), _without_stderr(), OpenEXR.File(str(path), separate_channels=True) as file:
        yield file


@contextmanager
def _without_stderr() -> Iterator[None]:
    """Discard native libraries' output to the process's standard error."""
    try:
        kept = os.dup(2)
    except OSError:
        # There is no standard error.
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(nowhere)
        os.close(kept)


def _names(path: Path, bands: Any) -> list[str]:
    names = bands if isinstance(bands, list) else []
    if bands is not None and not (names and all(isinstance(name, str) for name in names)):
        raise FileError(f"{path} is damaged: its bands must be a list of names")
    return names


def _numbers(path: Path, wavelengths_nm: Any) -> tuple[float, ...]:
    numbers = wavelengths_nm if isinstance(wavelengths_nm, list) else []
    if not numbers or not all(isinstance(number, int | float) for number in numbers):
        raise FileError(f"{path} is damaged: its wavelengths_nm must be a list of numbers")
    return tuple(numbers)


def _parse(path: Path, text: str) -> dict[str, Any]:
    try:
        metadata: Mapping[str, Any] = parse_json(text)
        return {"wavelengths_nm": metadata["wavelengths_nm"], **metadata}
    except (ValueError, KeyError, TypeError):
        raise FileError(f"{path} is damaged: its attribute {METADATA!r} is not the JSON that lfmesh writes") from None
