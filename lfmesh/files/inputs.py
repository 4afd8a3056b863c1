"""Copies of a scene's input files in its run, which can then be moved and rendered again."""

import shutil
from pathlib import Path
from typing import NamedTuple

from lfmesh.errors import FileError
from lfmesh.files.paths import relative
from lfmesh.geometry.files.mesh_file import companions
from lfmesh.scene import Scene
from lfmesh.scene.inputs import COPIES, digest_of, files_of

LIMIT_BYTES = 64 * 2**20
"""Total size of a run's copies, smallest files first; the rest is located by path and checked by digest."""


class Source(NamedTuple):
    """File that a scene names, with the files that it reads in turn."""

    path: Path
    others: list[str]
    bytes: int

    @classmethod
    def of(cls, path: Path) -> "Source":
        """Inspect a file."""
        others = companions(path)
        return cls(path, others, sum((path.parent / name).stat().st_size for name in [path.name, *others]))

    @property
    def movable(self) -> bool:
        """True if all companion files lie in its folder or below."""
        return all(not Path(name).is_absolute() and ".." not in Path(name).parts for name in self.others)


def within(scene: Scene, home: Path, staging: Path | None = None) -> Scene:
    """Return a scene as a run in `home` stores it: with paths relative to `home` and file digests.

    Parameters
    ----------
    scene : Scene
    home : Path
        Run folder.
    staging : Path, optional
        Staging folder of a new run, to copy files into. Without it, the run's existing copies are used.
    """
    names = dict.fromkeys(name for _, name in files_of(scene))
    paths, digests = {}, {}
    # Read the files anew, as they are now.
    scene = scene.in_folder(scene.folder)
    for name in names:
        try:
            paths[name] = scene.resolve(name)
        except FileError:
            # It has changed or gone since tracing: keep its digest, so that a later use reports the file.
            digests[name] = scene.digests[name]
            continue
        if paths[name].is_file():
            digests[name] = digest_of(paths[name])
    kept = {name: relative(paths.get(name, scene.folder / name), home) for name in names}
    there = {name: path for name, path in paths.items() if name in digests}
    if staging is not None:
        kept |= _copied(there, digests, staging)
    elif there:
        copies = {digest_of(path): path for path in (home / COPIES).rglob("*") if path.is_file()}
        kept |= {name: relative(copies[digests[name]], home) for name in there if digests[name] in copies}
    changes = {place: kept[name] for place, name in files_of(scene)}
    moved = scene.changed(changes) if changes else scene
    return moved.in_folder(home).with_digests({kept[name]: digest for name, digest in digests.items()})


def _copied(paths: dict[str, Path], digests: dict[str, str], staging: Path) -> dict[str, str]:
    """Copy the files that fit; return the copies' paths from the run folder by the names in the scene."""
    sources = {name: Source.of(path) for name, path in paths.items()}
    copies: dict[str, str] = {}
    by_contents: dict[tuple[str, str], str] = {}
    room = LIMIT_BYTES
    for name, source in sorted(sources.items(), key=lambda item: item[1].bytes):
        same = digests[name], source.path.name
        if same not in by_contents:
            if source.bytes > room or not source.movable:
                continue
            room -= source.bytes
            by_contents[same] = _copy(source, staging)
        copies[name] = by_contents[same]
    return copies


def _copy(source: Source, staging: Path) -> str:
    """Copy a file and its companions to a folder of their own; return its path from the run folder."""
    folder = Path(COPIES, source.path.stem) if source.others else Path(COPIES)
    stem, number = source.path.stem, 1
    place = folder / source.path.name
    while (staging / (folder if source.others else place)).exists():
        number += 1
        folder = Path(COPIES, f"{stem}-{number}") if source.others else folder
        place = folder / (source.path.name if source.others else f"{stem}-{number}{source.path.suffix}")
    for name in [source.path.name, *source.others]:
        copy = staging / (place if name == source.path.name else folder / name)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source.path.parent / name, copy)
    return place.as_posix()
