"""The gallery: every scene that comes with lfmesh, rendered small, with its source and the time that it took."""

import hashlib
import json
import math
import os
import shutil
import time
import warnings
from collections import defaultdict
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

import PIL.Image
from docs_reference import plain

import lfmesh as lf
from lfmesh.errors import PictureWarning
from lfmesh.scene.inputs import digest_of, files_of

SCENES = Path(__file__).resolve().parents[1] / "assets" / "scenes"

SAMPLES = 16
"""A pixel: enough to see what a scene shows."""

MOST_PIXELS = 640
"""Along each side; of a larger sensor the middle is rendered."""

PREVIEWS = ("preview.png", "preview_view.png")

WIDTH = 350
"""Pixels of a picture on the page: two stand side by side."""


def gallery(kept: Path, place: Path, program: str, *, quick: bool) -> tuple[str, dict[str, list[str]]]:
    """Return the page, its pictures written beside it, and the scenes that warn, by kind of warning.

    Parameters
    ----------
    kept : Path
        Folder of earlier renders, by digest of scene and program.
    place : Path
        Folder of the page.
    program : str
        Digest of the program.
    quick : bool
        Render nothing: only pictures that are kept are shown.
    """
    lines = [
        "# Gallery",
        "",
        f"Every scene that comes with lfmesh, rendered for this page with {SAMPLES} samples a pixel. Left the raw",
        "image; right, one value a lenslet: what the camera saw. Times include compiling where a scene was the",
        "first to need a kernel.",
        "",
    ]
    place.mkdir(parents=True, exist_ok=True)
    warns: dict[str, list[str]] = defaultdict(list)
    for path in sorted(SCENES.glob("*.toml")):
        scene = reduced(lf.load(path))
        folder = kept / f"{path.stem}-{digest(scene, program)}"
        if not (folder / "facts.json").is_file() and not quick:
            print(f"gallery: {path.stem}", flush=True)
            rendered(scene, folder)
        lines += entry(path, folder, place)
        for kind in facts_of(folder).get("warnings", []):
            warns[kind].append(path.stem)
    return "\n".join(lines), warns


def facts_of(folder: Path) -> dict[str, Any]:
    """Return the time and the warnings of a render; empty if it is not kept."""
    path = folder / "facts.json"
    facts: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
    return facts


def warned(scenes: Sequence[str], place: Path, page: Path) -> str:
    """Return a section with the pictures of scenes that warn; empty if there are none.

    Parameters
    ----------
    scenes : sequence of str
    place : Path
        Folder of the gallery's pictures.
    page : Path
        Page that the section is for.
    """
    if not scenes:
        return ""
    lines = ["", "## Scenes of the gallery that warn", ""]
    for scene in scenes:
        pictures = [path for name in PREVIEWS if (path := place / f"{scene}-{name}").is_file()]
        shown_here = " ".join(f"![{scene}]({os.path.relpath(path, page.parent)})" for path in pictures)
        link = f"{os.path.relpath(place / 'gallery.md', page.parent)}#{scene.replace('_', '-')}"
        lines += [f"[{scene}]({link}), {SAMPLES} samples a pixel:", "", shown_here, ""]
    return "\n".join(lines)


def reduced(scene: lf.Scene) -> lf.Scene:
    """Return the scene with few samples, and the middle of a large sensor with the lenslets before it."""
    sensor, mla = scene.camera.sensor, scene.camera.mla
    pixels = [min(count, MOST_PIXELS) for count in sensor.pixels]
    changes = {"camera.sensor.pixels": pixels, "transport.samples": SAMPLES, "transport.replicates": 4}
    if mla is not None:
        wide = [n * sensor.pixel_mm / pitch for n, pitch in zip(pixels, (mla.pitch_mm, mla.row_pitch_mm), strict=True)]
        changes["camera.mla.count"] = [min(all_, math.ceil(n) + 2) for all_, n in zip(mla.count, wide, strict=True)]
    return scene.changed(changes)


def digest(scene: lf.Scene, program: str) -> str:
    """Return a short name for a scene with its files, and the program that renders it."""
    files = {name: digest_of(scene.resolve(name)) for _, name in files_of(scene)}
    content = json.dumps([scene.model_dump(mode="json"), files, program], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:12]


def rendered(scene: lf.Scene, folder: Path) -> None:
    """Render a scene, and keep its pictures, warnings and time."""
    begun = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PictureWarning)
        image = lf.render(scene)
    seconds = time.perf_counter() - begun
    run = folder / "run"
    lf.save(image, run)
    for name in PREVIEWS:
        if (run / name).is_file():
            shutil.copyfile(run / name, folder / name)
    shutil.rmtree(run)
    kinds = sorted({type(each).__name__ for each in image.warnings})
    (folder / "facts.json").write_text(json.dumps({"seconds": seconds, "warnings": kinds}))


def shown(source: Path, target: Path) -> None:
    """Write a picture for the page: as wide as others, lenslets as squares."""
    with PIL.Image.open(source) as picture:
        width, height = picture.size
        size = WIDTH, max(1, round(height * WIDTH / width))
        enlarge = width < WIDTH
        how = PIL.Image.Resampling.NEAREST if enlarge else PIL.Image.Resampling.BOX
        picture.convert("RGB").resize(size, how).save(target, optimize=True)


def entry(path: Path, folder: Path, place: Path) -> list[str]:
    """Return the lines of a scene on the page."""
    text = path.read_text(encoding="utf-8")
    comment = takewhile(lambda line: line.rstrip("# \n"), text.splitlines())
    about = plain(" ".join(line.removeprefix("#") for line in comment if line.startswith("#")))
    lines = [f"## {path.stem}", "", f"[{path.name}](../../scenes/{path.name})", ""]
    lines += [about, ""] if about else []
    facts = facts_of(folder)
    if not facts:
        return [*lines, "Not rendered in this build.", ""]
    pictures = []
    for name in PREVIEWS:
        if (folder / name).is_file():
            own = f"{path.stem}-{name}"
            shown(folder / name, place / own)
            pictures.append(f"![{path.stem}]({own})")
    said = "".join(f" [{kind}](../warnings/{kind}.md)" for kind in facts["warnings"])
    return [*lines, " ".join(pictures), "", f"{facts['seconds']:.0f} s." + (f" Warns:{said}" if said else ""), ""]
