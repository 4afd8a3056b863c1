"""Folders of a dataset's items and cameras, each complete or absent.

items/000017/    run folder: raw image, scene, light field, true depth; item.json: drawn values
cameras/KEY/     run folder of the white image, calibration.json, camera.exr, cameras.json
"""

import json
import shutil
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lfmesh.errors import FileError, PictureWarning, collected, in_order
from lfmesh.files import run
from lfmesh.files.calibration import write_calibration
from lfmesh.files.camera_model import write_camera_model
from lfmesh.files.depth import save_truth
from lfmesh.files.field import save_field
from lfmesh.files.folder import staged, staged_file
from lfmesh.files.inside import refuse_link
from lfmesh.files.json_values import parse_json, plain_json
from lfmesh.lightfield.calibration.calibration import calibrate
from lfmesh.lightfield.calibration.white import white_scene
from lfmesh.lightfield.photographs.depth_truth import depth_truth
from lfmesh.lightfield.rays.camera_model import camera_model
from lfmesh.lightfield.views.decode import decode
from lfmesh.provenance import difference, program
from lfmesh.regular_file import read_text
from lfmesh.scene import Scene
from lfmesh.transport.render.image import Image
from lfmesh.waves.render import render

ITEMS, CAMERAS, FACTS, CAMERA_MODEL = "items", "cameras", "item.json", "camera.exr"


@dataclass(frozen=True)
class Item:
    """An item of a dataset.

    Attributes
    ----------
    point : int
        Number of the item, from 0.
    scene : Scene
    drawn : dict
        Drawn values, by path.
    camera : str
        Key of its camera, a folder name; "" if the dataset has no cameras.
    digest : str
        Digest of its input.
    parts : tuple of str
    views : int or None
        Views along each axis.
    threads : int
        Threads that trace it, without effect on the result.
    """

    point: int
    scene: Scene
    drawn: dict[str, Any]
    camera: str
    digest: str
    parts: tuple[str, ...]
    views: int | None = None
    threads: int = 0
    batch: int = 0

    @property
    def folder(self) -> str:
        """Folder of the item in the dataset."""
        return f"{ITEMS}/{self.point:06d}"

    def compute(self, given: bytes | Path) -> bytes:
        """Make the item in the dataset's folder; return the facts in its `item.json`."""
        assert isinstance(given, Path)
        facts: dict[str, Any] = {}

        def write(folder: Path) -> dict[str, Any]:
            image = _traced(self.scene, self.threads)
            run.save(image, folder)
            if "views" in self.parts:
                save_field(decode(image, white=self._white(given, image), views=self.views), folder)
            if "depth" in self.parts:
                save_truth(depth_truth(image.scene, views=self.views), folder)
            facts.update(self._facts(run.pixels_digest(folder)))
            return facts

        _whole(given / self.folder, self.digest, write)
        return json.dumps(plain_json(facts)).encode()

    def _white(self, data: Path, image: Image) -> Image | None:
        """Return the camera's white image, which does not depend on the camera's pose."""
        if "white" not in self.parts:
            return None
        white = run.open_run(data / CAMERAS / self.camera)
        return replace(white, scene=white_scene(image.scene))

    def _facts(self, pixels_sha256: str) -> dict[str, Any]:
        return {
            "item": self.point,
            "folder": self.folder,
            "camera": f"{CAMERAS}/{self.camera}" if self.camera else None,
            "drawn": self.drawn,
            "seed": self.scene.transport.seed,
            "pixels_sha256": pixels_sha256,
        }


def make_camera(scene: Scene, folder: Path, digest: str, parts: tuple[str, ...], views: int | None) -> None:
    """Make the folder of a camera: white image, calibration, camera model.

    Parameters
    ----------
    scene : Scene
        Camera at the origin.
    folder : Path
    digest : str
        Digest of its input.
    parts : tuple of str
    views : int or None
        Views along each axis.

    Raises
    ------
    LfmeshError
        The camera lets no light through.
    FileError
        The folder cannot be written.
    """

    def write(staging: Path) -> dict[str, Any]:
        if "white" in parts:
            run.save(_traced(white_scene(scene), 0), staging)
            write_calibration(staging / run.CALIBRATION, calibrate(scene))
        if "camera" in parts:
            write_camera_model(camera_model(scene, views=views), staging / CAMERA_MODEL)
        return {"camera": folder.name}

    _whole(folder, digest, write)


def facts_of(folder: Path, digest: str) -> dict[str, Any] | None:
    """Return the facts of a finished folder; None if there is none.

    Parameters
    ----------
    folder : Path
    digest : str
        Expected digest.

    Raises
    ------
    FileError
        The folder is damaged, or was made from other input.
    """
    path = folder / FACTS
    refuse_link(folder)
    if not folder.exists():
        return None
    try:
        facts: dict[str, Any] = parse_json(read_text(path))
        known, sizes = facts.pop("digest"), dict(facts.pop("files"))
        maker = facts.pop("program")
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise FileError(f"{path} is missing or damaged") from None
    if known != digest:
        raise FileError(f"{folder} follows from another template")
    if said := difference(maker):
        raise FileError(f"{folder} was made by another program ({said})")
    for name, size in sizes.items():
        file = folder / name
        if not file.is_file() or file.stat().st_size != size:
            raise FileError(f"{file} is missing or was cut short")
    return facts


def warnings_in(facts: Mapping[str, Any]) -> tuple[PictureWarning, ...]:
    """Return the warnings of a folder's pictures from its facts."""
    return tuple(map(PictureWarning.from_dict, facts.get("warnings", ())))


def _traced(scene: Scene, threads: int) -> Image:
    """Render with a number of threads that the image's scene does not record."""
    image = render(scene.changed({"transport.threads": threads}))
    return replace(image, scene=image.scene.changed({"transport.threads": scene.transport.threads}))


def _whole(folder: Path, digest: str, write: Callable[[Path], dict[str, Any]]) -> None:
    """Make a folder elsewhere, and move it into place when complete, with its warnings."""
    try:
        # At the same depth as the final place, so that relative paths stay valid.
        with (
            staged(folder.parent.parent) as outer,
            warnings.catch_warnings(record=True) as noted,
            collected() as found,
        ):
            warnings.simplefilter("always", UserWarning)
            staging = outer / folder.name
            staging.mkdir()
            facts = write(staging)
            if found:
                facts["warnings"] = [each.as_dict() for each in in_order(found)]
            if notes := list(dict.fromkeys(str(w.message) for w in noted if issubclass(w.category, UserWarning))):
                facts["notes"] = notes
            files = sorted(path for path in staging.rglob("*") if path.is_file())
            sizes = {path.relative_to(staging).as_posix(): path.stat().st_size for path in files}
            kept = {**facts, "digest": digest, "program": program(), "files": sizes}
            with staged_file(staging, FACTS) as file:
                file.write(json.dumps(plain_json(kept), indent=1, ensure_ascii=False).encode() + b"\n")
            if folder.exists():
                shutil.rmtree(folder)
            staging.replace(folder)
    except OSError as error:
        raise FileError(f"{folder} cannot be written: {error.strerror or error}") from None
