"""Datasets: scenes drawn from one template, each with raw image, views, true depth and camera: `lf.Dataset`."""

import hashlib
import json
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import FileError, LfmeshError, PictureWarning, in_order, summed_up, warn_caller
from lfmesh.files.folder import made_inside, recover, write_inside
from lfmesh.files.json_values import parse_json, plain_json
from lfmesh.files.paths import relative
from lfmesh.files.sealed import refuse_maker
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.rays.chief_rays import refuse_undecodable
from lfmesh.provenance import program
from lfmesh.regular_file import read_text
from lfmesh.scene import Scene, load
from lfmesh.scene.inputs import files_of
from lfmesh.scene.literals import counted
from lfmesh.scene.toml import table
from lfmesh.study.datasets.dataset_file import DatasetFile, Draw, read_dataset
from lfmesh.study.datasets.dataset_item import CAMERAS, ITEMS, Item, facts_of, make_camera, warnings_in
from lfmesh.study.metrics.pictures import in_a_line
from lfmesh.study.sweeps.axes import is_number
from lfmesh.study.sweeps.paths import value_at
from lfmesh.study.sweeps.plan import MOST_POINTS, path_faults, pinned_with, seed_of
from lfmesh.study.sweeps.pool import here, in_pool
from lfmesh.study.sweeps.progress import Progress, Report, reported
from lfmesh.study.sweeps.study import Shard, check_workers, cores, default_workers, lists_settings
from lfmesh.study.sweeps.study_file import refused
from lfmesh.study.sweeps.study_folder import append_event
from lfmesh.transport.build import build

INDEX, FACTS = "index.jsonl", "dataset.json"

FORMAT = 3
"""Format of the folder; a reader refuses any other."""


@dataclass(frozen=True)
class Made:
    """Finished part of a dataset.

    Attributes
    ----------
    done : int
        Items in the index.
    count : int
        Items wanted.
    failed : dict of str
        Reasons for items that could not be made in this run, by number.
    warnings : tuple of PictureWarning
        Warnings of items and cameras, one per class: how many have it, and the first one's text.
    noted : int
        Items with notes in the index.
    index : Path
    """

    done: int
    count: int
    failed: dict[int, str]
    warnings: tuple[PictureWarning, ...]
    noted: int
    index: Path


class Dataset:
    """Scenes drawn from one template. An item depends only on template, seed and its number.

    Parameters
    ----------
    scene : Scene
        Template.
    random : sequence of dict
        Quantities drawn for each item, with the keys of `[[random]]` in a dataset file.
    folder : Path, optional
        Base folder for patterns in `files`. Default: the current one.
    **settings
        Other keys of a dataset file: count, seed, parts, views, changes, ...

    Raises
    ------
    LfmeshError
        One line per fault.

    Examples
    --------
    >>> random = [{"path": "targets[0].position_mm[2]", "uniform": [-500.0, -300.0]}]
    >>> lf.Dataset(scene, random, count=100, seed=1).make("data/")
    """

    @lists_settings(DatasetFile, {"scene", "random"})
    def __init__(self, scene: Scene, random: Any = (), *, folder: str | Path = ".", **settings: Any) -> None:
        self._prepare(DatasetFile(scene="scene", random=tuple(random), **settings), scene, Path(folder), "dataset")

    @classmethod
    def load(cls, path: str | Path, *, count: int | None = None, seed: int | None = None) -> "Dataset":
        """Read a dataset file and its template, and check every item.

        Parameters
        ----------
        path : str or Path
        count, seed : int, optional
            Replace the file's.

        Returns
        -------
        Dataset

        Raises
        ------
        LfmeshError
            One line per fault.
        """
        path = Path(path)
        file = read_dataset(path)
        if count is not None and count < 1:
            raise LfmeshError(f"count = {count}: must be 1 or more")
        given = {key: value for key, value in (("count", count), ("seed", seed)) if value is not None}
        if given:
            file = DatasetFile(**{key: getattr(file, key) for key in DatasetFile.model_fields} | given)
        dataset = cls.__new__(cls)
        dataset._prepare(file, load(path.parent / file.scene), path.parent, str(path))
        return dataset

    def __repr__(self) -> str:
        return f"<Dataset: {counted(len(self), 'item')}, {', '.join(draw.path for draw in self.file.random)}>"

    def __len__(self) -> int:
        return self.file.count or 0

    def _prepare(self, file: DatasetFile, scene: Scene, folder: Path, name: str) -> None:
        self.file, self.folder, self.base = file, folder, scene
        faults = [] if file.count is not None else ["count: missing: the number of items"]
        if len(self) > MOST_POINTS:
            faults.append(f"count = {file.count}: a dataset has at most {MOST_POINTS:,} items; make several")
        faults += path_faults(file.changes, scene, "changes")
        if not faults and file.changes:
            self.base = scene.changed(file.changes)
        self.candidates = tuple(draw.candidates(folder) for draw in file.random)
        for i, draw in enumerate(file.random):
            faults += [f"random[{i}].{line}" for line in self._draw_faults(draw, self.candidates[i])]
        if file.parts and self.base.camera.mla is None:
            faults.append(f"parts = {list(file.parts)}: need a camera with a microlens array; give parts = []")
        if not faults:
            # Freeze the candidates: files that appear later are not used.
            drawn = zip(self.file.random, self.candidates, strict=True)
            self.base = pinned_with(self.base, ((draw.path, self._in_scene(draw, found)) for draw, found in drawn))
        faults = faults or list(self._item_faults())
        if faults:
            raise refused(name, faults)

    def _in_scene(self, draw: Draw, values: Iterable[Any]) -> list[Any]:
        """Return drawn values as written in the scene: file names relative to its folder."""
        if draw.files is None:
            return list(values)
        return [relative(self.folder / value, self.base.folder) for value in values]

    def _draw_faults(self, draw: Draw, candidates: tuple[Any, ...]) -> Iterator[str]:
        if draw.files is not None and not candidates:
            yield f'files = "{draw.files}": there is no such file in {self.folder}'
        found = list(path_faults({draw.path: None}, self.base, "path"))
        yield from found
        if not found and draw.relative and not is_number(value_at(self.base, draw.path)):
            yield f"relative: {draw.path} is {value_at(self.base, draw.path)!r} in the template, not a number to add to"

    def _item_faults(self) -> Iterator[str]:
        """Yield the items that are not valid scenes; cameras are solved, and files read, only once."""
        cameras: set[str] = set()
        files: set[str] = set()
        for number in range(len(self)):
            try:
                scene = self.scene(number)
                key, names = self.camera_scene(scene).digest, {name for _, name in files_of(scene)}
                if key not in cameras:
                    solved_camera(scene)
                    if self.file.parts and scene.camera.mla is not None:
                        refuse_undecodable(scene)
                if key not in cameras or not names <= files:
                    build(scene)
                cameras.add(key)
                files |= names
            except LfmeshError as error:
                yield f"item {number}{self._in_words(number)}: {in_a_line(error)}"
            except (KeyError, IndexError, TypeError, ValueError) as error:
                yield f"item {number}{self._in_words(number)}: cannot be set: {error}"

    def _in_words(self, number: int) -> str:
        return f" ({', '.join(f'{path} = {value}' for path, value in self.drawn(number).items())})"

    def drawn(self, number: int) -> dict[str, Any]:
        """Return the values drawn for an item; each path has random numbers of its own.

        File names are relative to the dataset file's folder.

        Parameters
        ----------
        number : int
            Number of the item, from 0.

        Returns
        -------
        dict
            Values by path, such as "camera.focus_mm".
        """
        return {
            draw.path: self._drawn(draw, found, number)
            for draw, found in zip(self.file.random, self.candidates, strict=True)
        }

    def _drawn(self, draw: Draw, candidates: tuple[Any, ...], number: int) -> Any:
        words = np.frombuffer(hashlib.sha256(draw.path.encode()).digest(), "<u4").tolist()
        share = float(np.random.default_rng([self.file.seed, number, *words]).random())
        value = candidates[int(share * len(candidates))] if candidates else draw.quantile(share)
        return value + value_at(self.base, draw.path) if draw.relative else value

    def scene(self, number: int) -> Scene:
        """Return the scene of an item, with random numbers of its own.

        Parameters
        ----------
        number : int
            Number of the item, from 0.

        Returns
        -------
        Scene

        Raises
        ------
        SceneError
            The scene is not valid.
        """
        values = {"transport.seed": seed_of(self.file.seed, number + 1), **self.drawn(number)}
        for draw in self.file.random:
            (values[draw.path],) = self._in_scene(draw, [values[draw.path]])
        return self.base.changed(values)

    def camera_scene(self, scene: Scene) -> Scene:
        """Return the camera of an item's scene alone, at the origin, with the template's random numbers.

        Parameters
        ----------
        scene : Scene
            From `scene`.

        Returns
        -------
        Scene
        """
        return scene.camera_alone({"name": "", "camera.pose": {}, "transport.seed": self.base.transport.seed})

    @cached_property
    def digest(self) -> str:
        """SHA-256 of template, files, draws, seed and parts, but not of the count."""
        facts = {
            "scene": self.base.digest,
            "inputs": self.base.digests,
            "random": [table(draw) for draw in self.file.random],
            "candidates": self.candidates,
            "seed": self.file.seed,
            "parts": sorted(self.file.parts),
            "views": self.file.views,
        }
        return _sha256(facts)

    def item(self, number: int, threads: int = 0) -> Item:
        """Return an item, ready to be made.

        Parameters
        ----------
        number : int
            Number of the item, from 0.
        threads : int
            Threads that render it; 0: all processors.

        Returns
        -------
        Item
        """
        scene, parts = self.scene(number), self.file.parts
        camera = self._camera_digest(self.camera_scene(scene))[:16] if {"white", "camera"} & set(parts) else ""
        facts = {"dataset": self.digest, "item": number}
        return Item(number, scene, self.drawn(number), camera, _sha256(facts), parts, self.file.views, threads)

    def _camera_digest(self, camera: Scene) -> str:
        inputs = {name: camera.digests[name] for _, name in files_of(camera)}
        return _sha256({"scene": camera.digest, "inputs": inputs, "parts": sorted(self.file.parts)})

    def make(
        self,
        folder: str | Path,
        *,
        workers: int | None = None,
        shard: Shard | None = None,
        progress: Report | bool | None = None,
    ) -> Made:
        """Make the missing items, and write the index of all finished ones.

        Parameters
        ----------
        folder : str or Path
            Folder of the dataset: new, or begun with this dataset and any count.
        workers : int, optional
            Number of processes; 0: only this one. Default: as many as the cores allow.
        shard : (int, int), optional
            Share of the items to make, such as (1, 3); several shares may run in one folder.
        progress : callable or bool, optional
            Called with the progress after each item. True shows it, False nothing. Default: it is shown at a terminal
            or in a notebook after two seconds.

        Returns
        -------
        Made
            Finished items, with their warnings.

        Warns
        -----
        PictureWarning
            Some pictures are or may be wrong: one warning per class, see `Made.warnings`.

        Raises
        ------
        KeyboardInterrupt
            After Ctrl-C; finished items are kept.
        LfmeshError
            The folder holds another dataset or cannot be written.
        """
        check_workers(workers)
        with reported(progress, "items", "item") as report:
            return _Making(self, Path(folder), report).complete(workers, shard)

    def summary(self) -> dict[str, Any]:
        """Return the dataset as plain values, as stored in its folder.

        Returns
        -------
        dict
        """
        described = table(self.file)
        described.pop("count", None)
        return {"format": FORMAT, "program": program(), "digest": self.digest, "dataset": described}


def _sha256(facts: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain_json(facts), sort_keys=True).encode()).hexdigest()


class _Making:
    """A dataset being made in a folder."""

    def __init__(self, dataset: Dataset, folder: Path, progress: Report | None) -> None:
        self.dataset, self.folder, self.progress = dataset, folder, progress
        self.failed: dict[int, str] = {}
        self.began, self.done, self.new = time.perf_counter(), 0, 0
        self.workers, self.later_seconds = 1, list[float]()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            recover(folder)
            for name in (ITEMS, CAMERAS):
                made_inside(folder, name)
        except OSError as error:
            raise FileError(f"{folder} cannot be written: {error.strerror or error}") from None
        self._refuse_other()
        write_inside(folder, FACTS, json.dumps(plain_json(dataset.summary()), indent=1, ensure_ascii=False) + "\n")

    def _refuse_other(self) -> None:
        try:
            known = parse_json(read_text(self.folder / FACTS))
            form, maker, digest = (known.get(key) for key in ("format", "program", "digest"))
        except FileNotFoundError:
            return
        except (OSError, ValueError, AttributeError):
            raise FileError(f"{self.folder / FACTS} is damaged; delete it to continue with the items there") from None
        refuse_maker(str(self.folder), FORMAT, form, maker)
        if digest != self.dataset.digest:
            raise LfmeshError(
                f"{self.folder} holds another dataset, or the template, the seed or a file that is drawn from has "
                "changed since: give another folder, or restore the original"
            )

    def complete(self, workers: int | None, shard: Shard | None) -> Made:
        """Make the missing items, and write the index."""
        first, step = (0, 1) if shard is None else (shard[0] - 1, shard[1])
        numbers = range(first, len(self.dataset), step)
        items = [self.dataset.item(number) for number in numbers]
        missing = [item for item in items if self._facts(item) is None]
        self.done = len(items) - len(missing)
        self._log("started", items=len(items), missing=len(missing), shard=shard)
        self._say(len(items))
        workers = default_workers(len(missing)) if workers is None else workers
        self.workers = max(1, min(workers, len(missing)))
        threads = max(1, cores() // max(workers, 1))
        try:
            able = self._with_cameras(missing)
            jobs = ((replace(item, threads=threads), self.folder.resolve()) for item in able)
            for result in in_pool(jobs, workers) if workers else here(jobs):
                number = result.unit.point
                self.new += 1
                if not result.is_first:
                    self.later_seconds.append(result.seconds)
                if result.content is None:
                    self._fail(number, result.reason)
                else:
                    self.done += 1
                    self._log("done", item=number)
                self._say(len(items))
        finally:
            made = self._indexed()
            self._log("stopped", done=made.done, failed=len(self.failed))
        warn_caller(made.warnings)
        return made

    def _with_cameras(self, missing: list[Item]) -> Iterator[Item]:
        """Yield the items whose camera folder exists; make the folder before its first item."""
        ready: dict[str, str] = {"": ""}
        for item in missing:
            if item.camera not in ready:
                ready[item.camera] = self._camera(item)
            if reason := ready[item.camera]:
                self._fail(item.point, reason)
            else:
                yield item

    def _camera(self, item: Item) -> str:
        """Make the folder of an item's camera if it is missing; return the reason for failure, or ""."""
        camera = self.dataset.camera_scene(item.scene)
        folder = self.folder / CAMERAS / item.camera
        try:
            if self._known(folder, item.camera) is None:
                make_camera(camera, folder, item.camera, item.parts, item.views)
        except LfmeshError as error:
            return f"its camera {item.camera}: {in_a_line(error)}"
        return ""

    def _facts(self, item: Item) -> dict[str, Any] | None:
        return self._known(self.folder / item.folder, item.digest)

    def _known(self, folder: Path, digest: str) -> dict[str, Any] | None:
        """Return the facts of a finished folder; log an unreadable one, which is then made again."""
        try:
            return facts_of(folder, digest)
        except FileError as error:
            self._log("unreadable", reason=str(error))
            return None

    def _indexed(self) -> Made:
        """Write the index: one line, in order, for each finished item of any process."""
        wanted = map(self.dataset.item, range(len(self.dataset)))
        known = [facts for item in wanted if (facts := self._facts(item)) is not None]
        lines = [json.dumps(facts, ensure_ascii=False, sort_keys=True) + "\n" for facts in known]
        write_inside(self.folder, INDEX, "".join(lines))
        items = {f"item {facts['item']}": warnings_in(facts) for facts in known}
        cameras = {name: self._camera_warnings(name) for name in sorted({f["camera"] for f in known if f["camera"]})}
        told = in_order([*summed_up(items, len(items), "items"), *summed_up(cameras, len(cameras), "cameras")])
        noted = sum("notes" in facts for facts in known)
        return Made(len(known), len(self.dataset), self.failed, told, noted, self.folder / INDEX)

    def _camera_warnings(self, name: str) -> tuple[PictureWarning, ...]:
        return warnings_in(self._known(self.folder / name, Path(name).name) or {})

    def _fail(self, number: int, reason: str) -> None:
        self.failed[number] = reason
        self._log("failed", item=number, reason=reason)

    def _log(self, event: str, **values: Any) -> None:
        append_event(self.folder, event, **values)

    def _say(self, total: int) -> None:
        if self.progress is not None:
            seconds = time.perf_counter() - self.began
            start = seconds
            if self.later_seconds:
                each = sum(self.later_seconds) / len(self.later_seconds) / self.workers
                start = max(0.0, seconds - each * self.new)
            self.progress(Progress(self.done, total, self.new, len(self.failed), seconds, start_seconds=start))
