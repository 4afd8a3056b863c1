"""Image as one EXR file: the pixels, with metadata for everything else needed to read it back."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfmesh
from lfmesh.errors import FileError, LfmeshError, PictureWarning, in_order
from lfmesh.files import exr
from lfmesh.files.inputs import within
from lfmesh.files.json_values import plain_json
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene
from lfmesh.scene.files import parse_toml
from lfmesh.scene.settings.transport import REPLICATES
from lfmesh.transport.checks.aim_proof import AimProof
from lfmesh.transport.checks.blind_check import BlindCheck
from lfmesh.transport.checks.found import found
from lfmesh.transport.checks.order_check import OrderCheck
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.render.adaptive import Refinement
from lfmesh.transport.render.certainty import Certainty
from lfmesh.transport.render.image import Image

FORMAT = 2
"""Version of the run folder's format; readers refuse any other."""

PARTS, HITS, ERROR, UPPER = ("raw", "stderr"), "hits", "error", "upper"


@contextmanager
def fitting(path: Path, advice: str) -> Iterator[None]:
    """Turn errors in a file's metadata into a one-line message that names the file.

    Parameters
    ----------
    path : Path
    advice : str
        Remedy, such as "render the scene again".
    """
    try:
        yield
    except (
        LfmeshError,
        KeyError,
        TypeError,
        ValueError,
        AttributeError,
        IndexError,
        ArithmeticError,
        RecursionError,
    ) as e:
        what = (
            f"{e.args[0]!r} is missing" if isinstance(e, KeyError) else f"{str(e).splitlines()[0] if str(e) else e!r}"
        )
        raise FileError(f"{path} is damaged: {what[:200]}; {advice}") from None


def refuse_damage(path: Path, spectral: exr.SpectralImage) -> None:
    """Raise a FileError if an image's pixels differ from the saved ones.

    Parameters
    ----------
    path : Path
        For the message.
    spectral : SpectralImage
    """
    if spectral.metadata.get("pixels_sha256") != _digest(*spectral.parts.values()):
        raise FileError(f"{path} is damaged: its pixels are not those that were saved")


def image_from(spectral: exr.SpectralImage, path: Path) -> Image:
    """Return the image of a file with verified pixels.

    Parameters
    ----------
    spectral : SpectralImage
    path : Path
        File, beside its scene.
    """
    with fitting(path, "render the scene again"):
        image = _image_of(spectral, path.parent)
        _refuse_impossible(image)
    return image


def _refuse_impossible(image: Image) -> None:
    """Raise a ValueError if an image's numbers cannot come from a render."""
    columns, rows = image.scene.camera.sensor.pixels
    shape = (rows, columns, image.scene.channels)
    if image.mean.shape != shape:
        raise ValueError(f"its pixels are {image.mean.shape}, but its scene's sensor has {shape}")
    if not np.isfinite(image.mean).all() or (image.mean < 0.0).any():
        raise ValueError("it has pixels that are negative, infinite or not numbers")
    # A single replicate has no spread, so its error is NaN.
    if np.isinf(image.stderr).any() or (image.stderr < 0.0).any():
        raise ValueError("it has standard errors that are negative or infinite")
    for name, value in {"seconds": image.seconds, "samples": image.samples, **image.timings}.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"{name} is {value!r}, not a number")
    if isinstance(image.replicates, bool) or not isinstance(image.replicates, int) or image.replicates < 0:
        raise ValueError(f"replicates_finished is {image.replicates!r}, not a count")
    if not isinstance(image.engine, str) or not isinstance(image.coatings, dict):
        raise ValueError("engine or coatings are not what lfmesh writes")


def _image_of(spectral: exr.SpectralImage, folder: Path) -> Image:
    metadata = spectral.metadata
    image = Image(
        mean=spectral.parts["raw"].astype(np.float64),
        stderr=spectral.parts["stderr"].astype(np.float64),
        scene=scene_from(metadata, folder),
        ledger=Ledger.from_dict(metadata["ledger"]),
        seconds=metadata["seconds"],
        replicates=metadata["replicates_finished"],
        samples=metadata["samples_per_pixel"],
        engine=metadata["engine"],
        timings=metadata.get("timings") or {},
        refinement=Refinement(**metadata["refinement"]) if metadata.get("refinement") else None,
        hits=spectral.parts.get(HITS),
        aim=AimProof.from_dict(metadata["aim"]) if metadata.get("aim") else None,
        blind=BlindCheck.from_dict(metadata["blind"]) if metadata.get("blind") else None,
        order=OrderCheck(**metadata["order"]) if metadata.get("order") else None,
        coatings=metadata.get("coatings") or {},
        certainty=_certainty_of(spectral.parts),
    )
    # Runs of older versions store no warnings, but the numbers behind them.
    told = metadata.get("warnings")
    image.warnings = in_order(found(image)) if told is None else tuple(PictureWarning.from_dict(each) for each in told)
    return image


def _certainty_of(parts: dict[str, NDArray[Any]]) -> Certainty | None:
    """Return the saved errors and bounds; None for an image of a single part, which computes them itself."""
    if ERROR not in parts or UPPER not in parts:
        return None
    return Certainty(parts[ERROR].astype(np.float64), parts[UPPER].astype(np.float64))


def write_image(path: Path, image: Image, home: Path) -> dict[str, Any]:
    """Write the pixels of an image for a run that will live in `home`; return the metadata.

    Parameters
    ----------
    path : Path
    image : Image
    home : Path
        Run folder.
    """
    mean, stderr = (np.asarray(pixels, dtype=np.float32) for pixels in (image.mean, image.stderr))
    parts: dict[str, NDArray[Any]] = {"raw": mean, "stderr": stderr}
    if image.hits is not None:
        parts[HITS] = np.asarray(image.hits, np.uint32)
    if image.certainty is not None:
        parts |= {name: np.asarray(getattr(image.certainty, name), np.float32) for name in (ERROR, UPPER)}
    metadata = _metadata(image, _digest(*parts.values()), home)
    exr.write(path, exr.SpectralImage(parts, image.wavelengths_nm, metadata))
    return metadata


def _metadata(image: Image, pixels_sha256: str, home: Path) -> dict[str, Any]:
    transport = image.scene.transport
    metadata = {
        "format": FORMAT,
        "lfmesh_version": lfmesh.__version__,
        "name": image.scene.name,
        "warnings": [warning.as_dict() for warning in image.warnings],
        "unit": "W per pixel",
        "orientation": Upright.of(image.scene).raw_in_words,
        "wavelengths_nm": list(image.wavelengths_nm),
        "scene_digest": image.scene.digest,
        **scene_metadata(image.scene, home),
        "seed": transport.seed,
        "method": transport.method,
        "engine": image.engine,
        "complete": image.complete,
        "replicates": transport.replicates,
        "replicates_finished": image.replicates,
        "samples_per_pixel": image.samples,
        "refinement": asdict(image.refinement) if image.refinement else None,
        "aim": image.aim._asdict() if image.aim else None,
        "blind": asdict(image.blind) if image.blind else None,
        "order": asdict(image.order) if image.order else None,
        "coatings": image.coatings,
        "seconds": image.seconds,
        "timings": image.timings,
        "ledger": image.ledger.as_dict(),
        "pixels_sha256": pixels_sha256,
    }
    finite: dict[str, Any] = plain_json(metadata)
    return finite


def _digest(*parts: NDArray[Any]) -> str:
    """Hash the pixels as stored; equal only for runs that agree in every bit."""
    digest = hashlib.sha256()
    for pixels in parts:
        digest.update(np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("<")).data)
    return digest.hexdigest()


def scene_metadata(scene: Scene, home: Path) -> dict[str, Any]:
    """Return the metadata that `scene_from` reads, for a file that will live in `home`."""
    scene = scene if scene.folder == home.resolve() and scene.digests else within(scene, home)
    return {
        "scene_toml": scene.dump_toml(),
        "scene_title": scene.title,
        "scene_folder": ".",
        "inputs": scene.digests,
    }


def scene_from(metadata: dict[str, Any], folder: Path) -> Scene:
    """Return the scene as rendered, without checking that its meshes and textures still exist."""
    table = parse_toml(metadata["scene_toml"])
    # Older files omit the number of replicates where it was the default, 8.
    table.setdefault("transport", {}).setdefault("replicates", REPLICATES)
    scene = Scene(**table).in_folder(folder / metadata["scene_folder"]).titled(str(metadata.get("scene_title", "")))
    inputs = metadata.get("inputs", {})
    if not isinstance(inputs, dict) or not all(isinstance(digest, str) for digest in inputs.values()):
        raise ValueError("inputs are not digests by path")
    return scene.with_digests(inputs)
