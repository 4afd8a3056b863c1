"""Shares of a render on disk: the pieces that each machine traced, and the image made from all.

share/render.json       the render, and its number of pieces share/pieces/*.npz      one file per piece, written
completely or not at all

Shares may have separate folders or a common one. The image is bitwise identical to that of an undivided render.
"""

import hashlib
import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError, LfmeshError
from lfmesh.files.folder import made_inside, recover, staged_file
from lfmesh.files.image_file import scene_from, scene_metadata
from lfmesh.files.json_values import parse_json
from lfmesh.files.sealed import read_sealed, refuse_maker, write_sealed
from lfmesh.provenance import program
from lfmesh.regular_file import read_text
from lfmesh.scene import Scene
from lfmesh.transport.build import build
from lfmesh.transport.checks.blind_check import BlindSamples
from lfmesh.transport.render.image import Image
from lfmesh.transport.render.jobs import Job, jobs_of, reduced
from lfmesh.transport.render.tally import ChunkTally, Film, Piece, Work, arrays_of, filled
from lfmesh.transport.render.tracer import Tracer

FACTS, PIECES = "render.json", "pieces"

SEAL = "sha256"
"""Key of the digest of the other facts."""

FORMAT = 3
"""Version of the folder's format; readers refuse any other."""

SECONDS = "tracing_seconds"
"""Key of a piece's elapsed tracing time."""

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Cut:
    """Division of a render among shares.

    Attributes
    ----------
    scene : Scene
        Scene with the digests of its files.
    shares : int
    facts : dict
        Values common to all shares, from the author's scene: the copy in a folder has other paths.
    """

    scene: Scene
    shares: int
    facts: dict[str, Any]

    @classmethod
    def of(cls, scene: Scene, shares: int) -> "Cut":
        """Return the division of a scene as written by its author."""
        facts = {
            "format": FORMAT,
            "program": program(),
            "scene": scene.changed({"transport.threads": 0}).digest,
            "files": sorted(scene.digests.values()),
            "shares": shares,
        }
        return cls(scene, shares, facts)

    @property
    def blocks(self) -> int:
        """Approximate number of blocks per replicate at which all shares have equally many pieces."""
        return self.shares // math.gcd(self.shares, self.scene.transport.replicates)

    def jobs(self, tracer: Tracer) -> list[Job]:
        """Return all jobs, replicate by replicate."""
        return list(jobs_of(self.scene, range(self.scene.transport.replicates), tracer.plan.blocks(self.blocks)))

    def facts_of(self, job: Job) -> dict[str, Any]:
        """Return the facts that identify a piece."""
        return self.facts | {"replicate": job.replicate, "pixels": [job.block.first, job.block.last]}


def trace_share(
    scene: Scene, folder: Path, share: int, shares: int, progress: Callable[[int, int], None] | None = None
) -> int:
    """Trace a share's missing pieces; return its total number of pieces.

    Parameters
    ----------
    scene : Scene
        With the digests of its files, see `Scene.pinned`.
    folder : Path
        New, or holding part of a share of this render.
    share, shares : int
        Number of the share, from 1, and of all shares.
    progress : callable, optional
        Called with the numbers of finished and of all pieces.

    Raises
    ------
    FileError
        The folder cannot be written, or holds pieces of another render.
    LfmeshError
        The scene cannot be divided.
    """
    if scene.transport.target_error is not None:
        raise LfmeshError(
            "transport.target_error: the pixels that need more samples are known only when all shares are done: omit "
            "it, or use --dask"
        )
    cut = Cut.of(scene, shares)
    _begin(folder, cut)
    tracer = Tracer(build(scene))
    mine = cut.jobs(tracer)[share - 1 :: shares]
    for done, job in enumerate(mine):
        if progress is not None:
            progress(done, len(mine))
        name = _name(job)
        if not _is_whole(folder / PIECES / name, cut.facts_of(job)):
            began = time.perf_counter()
            arrays = _packed(tracer.piece(job.replicate, job.block))
            arrays[SECONDS] = np.array(time.perf_counter() - began)
            try:
                with staged_file(folder / PIECES, name) as file:
                    write_sealed(file, FORMAT, cut.facts_of(job), arrays)
            except OSError as error:
                raise FileError(
                    f"{folder / PIECES / name} cannot be written: {error.strerror or error}; finished pieces are kept"
                ) from None
    if progress is not None:
        progress(len(mine), len(mine))
    return len(mine)


def merged(folders: Sequence[Path]) -> Image:
    """Merge the shares of a render; its time is the sum of theirs.

    Parameters
    ----------
    folders : sequence of Path
        All shares, in any order.

    Raises
    ------
    FileError
        A folder holds no share or one of another render, or a piece is missing or damaged.
    """
    held = [_facts(folder) for folder in folders]
    for folder, facts in zip(folders, held, strict=True):
        if facts["cut"] != held[0]["cut"]:
            raise FileError(f"{folder} holds a share of another render than {folders[0]}")
    scene = scene_from(held[0], folders[0])
    cut = Cut(scene, held[0]["cut"]["shares"], held[0]["cut"])
    tracer = Tracer(build(scene))
    places = [_found(folders, job) for job in cut.jobs(tracer)]
    missing = sorted({number % cut.shares + 1 for number, place in enumerate(places) if place is None})
    if missing:
        one = missing[0]
        raise FileError(
            f"{sum(place is None for place in places)} of {len(places)} pieces are missing, of share "
            f"{', '.join(f'{number}/{cut.shares}' for number in missing)}: name their folder, or trace them: "
            f"lfmesh render scene.toml -o folder/ --shard {one}/{cut.shares}"
        )

    seconds = 0.0

    def read(jobs: Iterable[Job]) -> Iterator[Piece]:
        nonlocal seconds
        for job, place in zip(jobs, places, strict=True):
            assert place is not None
            piece, own = _unpacked(place, cut, job, tracer)
            seconds += own
            yield piece

    image = reduced(tracer, read, cut.blocks)
    return replace(image, seconds=seconds, timings=image.timings | {SECONDS: seconds})


def _begin(folder: Path, cut: Cut) -> None:
    """Make the folder of a share, or check that it belongs to this render."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        recover(folder)
        made_inside(folder, PIECES)
        if not (folder / FACTS).exists():
            others = [path.name for path in folder.iterdir() if path.name != PIECES]
            if others:
                raise FileError(f"{folder} holds {others[0]}, not a share of a render: give a new folder")
            facts: dict[str, Any] = {"cut": cut.facts, **scene_metadata(cut.scene, folder)}
            facts[SEAL] = _seal(facts)
            with staged_file(folder, FACTS) as file:
                file.write((json.dumps(facts, ensure_ascii=False, indent=1) + "\n").encode())
            return
    except OSError as error:
        raise FileError(f"{folder}: cannot be written: {error.strerror or error}") from None
    if _facts(folder)["cut"] != cut.facts:
        raise FileError(
            f"{folder} holds pieces of another render: the scene, a file that it reads, its settings or the number of "
            "shares have changed since; give another folder, or restore the original"
        )


def _seal(facts: dict[str, Any]) -> str:
    """Return the digest of a folder's facts."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def _facts(folder: Path) -> dict[str, Any]:
    try:
        facts: dict[str, Any] = parse_json(read_text(folder / FACTS))
        form, maker = facts["cut"]["format"], facts["cut"]["program"]
        known = form != FORMAT or facts.pop(SEAL) == _seal(facts)
    except FileNotFoundError:
        raise FileError(f"{folder} holds no share of a render: there is no {FACTS} in it") from None
    except (OSError, ValueError, KeyError, TypeError):
        known = False
    if not known:
        raise FileError(f"{folder / FACTS} is damaged: delete the folder, and trace its share again")
    try:
        refuse_maker(str(folder), FORMAT, form, maker)
    except FileError as error:
        raise FileError(f"{error}: trace its share again") from None
    return facts


def _name(job: Job) -> str:
    return f"replicate{job.replicate:04d}-pixel{job.block.first:09d}.npz"


def _found(folders: Sequence[Path], job: Job) -> Path | None:
    places = (folder / PIECES / _name(job) for folder in folders)
    return next((place for place in places if place.exists()), None)


def _is_whole(path: Path, facts: dict[str, Any]) -> bool:
    try:
        return read_sealed(path, FORMAT)[0] == facts
    except (FileError, FileNotFoundError):
        return False


def _packed(piece: Piece) -> Arrays:
    """Return a piece as named arrays."""
    chunks = piece.chunks
    arrays: Arrays = {
        **arrays_of(piece.films, "films"),
        "number": np.array([chunk.number for chunk in chunks], np.int64),
        "book": np.array([chunk.book for chunk in chunks]),
        "counts": np.array([chunk.work.counts for chunk in chunks]),
        "packets": np.array([(chunk.work.packets, chunk.work.queries) for chunk in chunks], np.int64),
        "seconds": np.array([(chunk.work.embree_seconds, chunk.work.thread_seconds) for chunk in chunks]),
        "part": np.array([chunk.part for chunk in chunks], np.int64),
        "fallen": np.array([len(chunk.deposits) for chunk in chunks], np.int64),
    }
    if chunks:
        arrays["deposits"] = np.concatenate([chunk.deposits for chunk in chunks])
    return arrays | (arrays_of(piece.blind, "blind") if piece.blind is not None else {})


def _unpacked(path: Path, cut: Cut, job: Job, tracer: Tracer) -> tuple[Piece, float]:
    """Read a piece and its tracing time in seconds.

    Raises
    ------
    FileError
        The file is damaged, or belongs to another render or piece.
    """
    pixels = job.block.last - job.block.first
    try:
        facts, held = read_sealed(path, FORMAT)
        if facts != cut.facts_of(job):
            raise FileError(
                f"{path} is a piece of another render, or another piece: delete it, and run its share again"
            )
        empty = tuple(Film.empty(pixels, tracer.channels) for _ in range(tracer.layout.from_pixels))
        films: tuple[Film, ...] = filled(empty, held, "films")
        blind: BlindSamples | None = None
        if any(name.startswith("blind.") for name in held):
            blind = filled(BlindSamples(*tracer.shape), held, "blind")
        ends = np.cumsum(held["fallen"])
        chunks = [
            ChunkTally(
                int(number),
                held["book"][i],
                Work(
                    held["counts"][i],
                    int(held["packets"][i, 0]),
                    int(held["packets"][i, 1]),
                    float(held["seconds"][i, 0]),
                    float(held["seconds"][i, 1]),
                ),
                held["deposits"][ends[i] - held["fallen"][i] : ends[i]],
                int(held["part"][i]),
            )
            for i, number in enumerate(held["number"])
        ]
        seconds = float(held[SECONDS])
    except (OSError, ValueError, KeyError, IndexError, TypeError):
        raise FileError(f"{path} is damaged: delete it, and run its share again") from None
    return Piece(job.replicate, job.block.first, job.block.last, films, chunks, blind), seconds
