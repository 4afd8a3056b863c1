"""The report of speed against error, for every level of `surface` and for images.

    lfmesh accuracy scene.toml -o report/

measures the scene's lens, array and images. Without a scene, it measures the lenses that come with lfmesh and the
images of its first scene.
"""

import os
import platform
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

import lfmesh
from lfmesh.accuracy import page, tables, verdict
from lfmesh.accuracy.image_efficiency import QUICK, USUAL, ImageStudy, study_images
from lfmesh.accuracy.lens_accuracy import QUICK_RAYS, QUICK_RINGS, RAYS, RINGS, LensStudy, lens_scenes, study_lens
from lfmesh.assets import asset_path
from lfmesh.errors import FileError
from lfmesh.files.whole import try_folder
from lfmesh.scene import Scene

LENS_CSV, IMAGE_CSV, PAGE = "lenses.csv", "images.csv", "accuracy.html"


@dataclass(frozen=True)
class AccuracyReport:
    """All results of the measurement."""

    title: str
    lenses: tuple[LensStudy, ...]
    images: ImageStudy | None

    def write(self, folder: str | Path) -> list[Path]:
        """Write the tables and the page into a folder, created if needed; return their paths.

        Raises
        ------
        FileError
            The folder cannot be written.
        """
        prepare(folder)
        folder = Path(folder)
        contents = {
            LENS_CSV: tables.csv_table([row for study in self.lenses for row in study.rows]),
            PAGE: page.page(self.lenses, self.images, self.title, made_on()),
        }
        if self.images is not None:
            contents[IMAGE_CSV] = tables.csv_table(self.images.rows)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name, text in contents.items():
                (folder / name).write_text(text, encoding="utf-8")
        except OSError as error:
            raise FileError(f"{folder}: cannot be written: {error.strerror}") from None
        return [folder / name for name in contents]

    def print(self, console: Console) -> None:
        """Print the tables, each with its conclusions."""
        for study in self.lenses:
            for way in study.ways:
                rows = [tables.short_lens_columns(row) for row in study.of(way)]
                _print_table(console, f"{study.name}: {tables.WAY_TITLE[way]}", rows, "surface")
                _print_words(console, verdict.about_triangles(study, way))
                _print_words(console, verdict.about_time(study, way))
                console.print()
            _print_words(console, verdict.about_the_truth(study))
            console.print()
        if self.images is not None:
            rows = [tables.short_image_columns(row) for row in self.images.rows]
            _print_table(console, f"Images of {self.images.scene}", rows, "estimate")
            _print_words(console, verdict.about_images(self.images))
            _print_words(console, verdict.about_image_time(self.images))
        else:
            _print_words(console, verdict.NO_LIGHT)


def prepare(folder: str | Path) -> None:
    """Check before the long measurement that a report can be written; leave nothing behind.

    Raises
    ------
    FileError
        The folder is a file, or cannot be created or written.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise FileError(f"{folder}: is a file; give a folder for the report")
    try_folder(folder)


def measure(
    scene: Scene | None = None, *, quick: bool = False, progress: Callable[[str], None] | None = None
) -> AccuracyReport:
    """Measure a scene's lens, array and images, or without a scene the lenses that come with lfmesh.

    Parameters
    ----------
    scene : Scene, optional
    quick : bool
        Use fewer meshes, rays and samples: half a minute in place of a few.
    progress : callable, optional
        Called with a description of the current step.

    Raises
    ------
    LfmeshError
        The scene cannot be built, or its lens is a mesh without an analytic surface.
    """
    rings, rays, effort = (QUICK_RINGS, QUICK_RAYS, QUICK) if quick else (RINGS, RAYS, USUAL)
    scenes = [scene] if scene is not None else lens_scenes()
    pictured = scene if scene is not None else lfmesh.load(asset_path("scenes/first_light.toml"))
    lenses = tuple(study_lens(one, rings=rings, rays=rays, progress=progress) for one in scenes)
    images = study_images(pictured, effort, progress) if shines(pictured) else None
    name = scene.title if scene is not None else "the lenses that come with lfmesh"
    return AccuracyReport(f"Accuracy of {name or 'an unnamed scene'}", lenses, images)


def made_on() -> str:
    """Return versions and machine in one line."""
    return (
        f"lfmesh {lfmesh.__version__}, Python {platform.python_version()}, {platform.machine()}, "
        f"{os.cpu_count()} cores; times are of one core"
    )


def shines(scene: Scene) -> bool:
    """Tell whether a scene has a light, particles or a target that emits."""
    return bool(scene.lights or scene.particles) or any(target.material.emits for target in scene.targets)


def _print_table(console: Console, title: str, rows: list[dict[str, str]], grouped_by: str) -> None:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, padding=(0, 1, 0, 0), pad_edge=False)
    for name in rows[0]:
        table.add_column(name, justify="left" if name == grouped_by else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row.values())
    console.print(table)


def _print_words(console: Console, text: str) -> None:
    console.print(text, highlight=False, markup=False)
