"""`lf.Study`: a study from its file to its table."""

import inspect
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from lfmesh.errors import FileError, LfmeshError, warn_caller
from lfmesh.files.folder import write_inside
from lfmesh.regular_file import read_bytes
from lfmesh.scene import Scene
from lfmesh.scene.literals import counted
from lfmesh.scene.model import Model
from lfmesh.signatures import Function
from lfmesh.study.metrics.metrics import columns_of
from lfmesh.study.sweeps.cluster import in_dask
from lfmesh.study.sweeps.plan import Plan, load_scenes, plan_of
from lfmesh.study.sweeps.pool import Result, here, in_pool
from lfmesh.study.sweeps.progress import Progress, Report, reported
from lfmesh.study.sweeps.sentences import beyond_limits, unknown_of_reference
from lfmesh.study.sweeps.study_file import StudyFile, read_study
from lfmesh.study.sweeps.study_folder import StudyFolder, read_facts, refuse_other
from lfmesh.study.sweeps.table import Table, table_of
from lfmesh.study.sweeps.unit import Outcome, Unit, reference_films, unpacked

TABLE, PAGE, TIMES, PARQUET = "table.csv", "report.html", "times.csv", "table.parquet"

Shard = tuple[int, int]
"""Number of a shard of the units, from 1, and the number of shards."""


def lists_settings(kind: type[Model], own: set[str]) -> Callable[[Function], Function]:
    """Give a constructor a signature that lists the keys of a file, for help and completion.

    Parameters
    ----------
    kind : type of Model
        Model of the file.
    own : set of str
        Keys that are not settings.
    """

    def decorate(init: Function) -> Function:
        signature = inspect.signature(init)
        *named, _ = signature.parameters.values()
        more = [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=field.get_default(call_default_factory=True)
            )
            for name, field in kind.model_fields.items()
            if name not in own
        ]
        init.__signature__ = signature.replace(parameters=[*named, *more])  # type: ignore[attr-defined]
        return init

    return decorate


class Study:
    """Comparison of many cameras with a reference.

    Parameters
    ----------
    scene : Scene or sequence of Scene
        Reference camera, or the scenes to compare, the reference first.
    axes : sequence of dict
        Axes, with the keys of `[[axes]]` in a study file.
    **settings
        Other keys of a study file: metrics, design, paired, ...

    Raises
    ------
    LfmeshError
        One line per fault.

    Examples
    --------
    >>> study = lf.Study(scene, axes=[{"path": "camera.mla.pose.tilt_deg[2]", "values": [0.0, 0.05, 0.1]}])
    >>> table = study.run("out/")
    """

    @lists_settings(StudyFile, {"scene", "scenes", "axes"})
    def __init__(self, scene: Scene | Sequence[Scene], axes: Sequence[Mapping[str, Any]] = (), **settings: Any) -> None:
        if isinstance(scene, Scene):
            study = StudyFile(scene="scene", axes=tuple(axes), **settings)
        else:
            names = tuple(one.name or f"scene {i}" for i, one in enumerate(scene))
            study = StudyFile(scenes=names, **settings)
        self.plan = plan_of(study, scene)

    @classmethod
    def load(cls, path: str | Path) -> "Study":
        """Read a study file and its scene, and check every point.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        Study

        Raises
        ------
        LfmeshError
            One line per fault.
        """
        path = Path(path)
        file = read_study(path)
        return cls._of(plan_of(file, load_scenes(file, path.parent), str(path)))

    @classmethod
    def _of(cls, plan: Plan) -> "Study":
        study = cls.__new__(cls)
        study.plan = plan
        return study

    def __repr__(self) -> str:
        points, units = counted(len(self.plan.points), "point"), counted(len(self.plan.units), "unit")
        return f"<Study: {points}, {units}, {', '.join(self.plan.metrics)}>"

    def run(
        self,
        folder: str | Path,
        *,
        workers: int | None = None,
        dask: str | None = None,
        shard: Shard | None = None,
        progress: Report | bool | None = None,
    ) -> Table:
        """Compute the missing units, and write the table; its bits do not depend on the way of computing.

        Parameters
        ----------
        folder : str or Path
            Folder of the study: new, or begun with this study.
        workers : int, optional
            Number of processes; 0: only this one. Default: as many as the cores allow.
        dask : str, optional
            Address of a dask scheduler, or "local".
        shard : (int, int), optional
            Share of the units to compute, such as (1, 3); `merge` combines the shares.
        progress : callable or bool, optional
            Called with the progress after each unit. True shows it, False nothing. Default: it is shown at a terminal
            or in a notebook after two seconds.

        Returns
        -------
        Table

        Warns
        -----
        PictureWarning
            Some pictures are or may be wrong: one warning per class, see `Table.warnings`.

        Raises
        ------
        KeyboardInterrupt
            After Ctrl-C; finished units are kept.
        LfmeshError
            The folder holds another study or cannot be written.
        """
        check_workers(workers)
        with reported(progress) as report:
            return Run(self.plan, Path(folder), report).complete(workers, dask, shard)

    def table(self, folder: str | Path) -> Table:
        """Return the table of the finished units in a folder.

        Parameters
        ----------
        folder : str or Path

        Returns
        -------
        Table
        """
        return Run(self.plan, Path(folder)).table()

    def merge(self, folders: Sequence[str | Path], into: str | Path) -> Table:
        """Combine the units in several folders of this study, and write the table.

        Parameters
        ----------
        folders : sequence of str or Path
            Folders of this study's shards.
        into : str or Path
            Folder to write to.

        Returns
        -------
        Table

        Raises
        ------
        LfmeshError
            A folder holds another study or none; nothing is written then.
        """
        parts = [Path(folder) for folder in folders]
        for part in parts:
            known = read_facts(part)
            if known is None:
                raise LfmeshError(f"{part} holds no study")
            refuse_other(known, self.plan.digest, part)
        run = Run(self.plan, Path(into))
        for part in parts:
            run.take(part)
        return _warned(run.written())


def _warned(table: Table) -> Table:
    """Warn of possible faults of the pictures behind a table, one line per class."""
    warn_caller(table.warnings)
    return table


def check_workers(workers: int | None) -> None:
    """Refuse a negative number of processes."""
    if workers is not None and workers < 0:
        raise LfmeshError(f"workers = {workers}: must be 0, this process alone, or more")


def default_workers(units: int) -> int:
    """Return the number of processes for the machine's cores, at most one per unit."""
    return max(1, min(cores(), units))


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Run:
    """A study being computed in a folder."""

    def __init__(self, plan: Plan, folder: Path, progress: Report | None = None) -> None:
        self.plan, self.progress = plan, progress
        self.folder = StudyFolder(folder, plan)
        self.outcomes: dict[tuple[int, int], Outcome] = {}
        self.faults: dict[int, str] = {}
        self.began = time.perf_counter()
        self.new = self.cameras = 0

    def complete(self, workers: int | None, dask: str | None, shard: Shard | None) -> Table:
        """Compute the missing units, and write the table.

        Parameters
        ----------
        workers : int, optional
            Processes of the pool.
        dask : str, optional
            Address of a scheduler, or "local", instead of the pool.
        shard : (int, int), optional
            Number of this share, from 1, and of all shares.
        """
        units = self.plan.units if shard is None else self.plan.units[shard[0] - 1 :: shard[1]]
        missing = self._missing(units)
        self.folder.log("started", units=len(units), missing=len(missing), shard=shard)
        self._say(units)
        if workers is None:
            workers = default_workers(len(missing))
        threads = max(1, cores() // max(workers, 1)) if dask is None else 1
        try:
            for result in self._results(missing, threads, workers, dask):
                self._take(result)
                self._say(units)
        except KeyboardInterrupt:
            self.folder.log("interrupted", done=self.new)
            self.written()
            raise
        self.folder.log("finished", done=self.new, failed=len(self.faults))
        return _warned(self.written())

    def _missing(self, units: list[tuple[int, int]]) -> list[tuple[int, int]]:
        """Return the units without an outcome, including unreadable ones, which are logged."""
        missing = []
        for point, batch in units:
            try:
                outcome = self.folder.outcome(point, batch)
            except FileError as error:
                self.folder.log("unreadable", point=point, batch=batch, reason=str(error))
                outcome = None
            if outcome is None:
                missing.append((point, batch))
            else:
                self.outcomes[point, batch] = outcome
        return missing

    def _results(
        self, missing: list[tuple[int, int]], threads: int, workers: int, dask: str | None
    ) -> Iterator[Result]:
        if not missing:
            return
        for batch in sorted({batch for _, batch in missing}):
            if not self.folder.has_reference(batch):
                # Alone and with all cores; it also compiles the kernels for the others.
                content = reference_films(self._unit(0, batch, 0))
                self.folder.keep_reference(batch, content)
        jobs = (
            (self._unit(point, batch, threads), self.folder.reference_path(batch).resolve()) for point, batch in missing
        )
        if dask is not None:
            yield from in_dask(self._logged(jobs), dask, workers)
        elif workers:
            yield from in_pool(self._logged(jobs), workers)
        else:
            yield from here(self._logged(jobs))

    def _logged(self, jobs: Iterable[tuple[Unit, Path]]) -> Iterator[tuple[Unit, Path]]:
        for unit, path in jobs:
            self.folder.log("begun", point=unit.point, batch=unit.batch)
            yield unit, path

    def _unit(self, point: int, batch: int, threads: int) -> Unit:
        plan = self.plan
        return Unit(
            study=plan.digest,
            point=point,
            batch=batch,
            camera=plan.camera_of(plan.points[point]),
            reference=plan.camera_of(plan.points[0]),
            metrics=plan.metrics,
            replicates=plan.replicates_of(batch),
            threads=threads,
            compensators=plan.study.compensators,
            search=plan.search_of(plan.points[point]),
        )

    def _take(self, result: Result) -> None:
        """Keep a unit's outcome, or log why there is none."""
        point, batch = result.unit.point, result.unit.batch
        self.new += 1
        self.cameras += self.plan.cameras_of(self.plan.points[point])
        reason = result.reason
        if result.content is not None:
            outcome = unpacked(result.content, self.plan.digest, point, batch, self.plan.metrics)
            self.outcomes[point, batch] = outcome
            reason = outcome.fault or ""
            if point == 0:
                self._warn_of_reference(outcome)
            try:
                self.folder.keep(point, batch, result.content)
            except OSError as error:
                # This run's table still has it; a later run computes it again.
                self.folder.log("not written", point=point, batch=batch, reason=error.strerror or str(error))
            else:
                self.folder.log("done", point=point, batch=batch, seconds=outcome.seconds, deaths=result.deaths)
            for metric, why in outcome.unknown.items():
                self.folder.log("unknown", point=point, batch=batch, metric=metric, reason=why)
            for metric, met in outcome.on_the_way.items():
                self.folder.log("unknown on the way", point=point, batch=batch, metric=metric, **met._asdict())
        if reason:
            self.faults[point] = reason
            label = self.plan.label(self.plan.points[point])
            self.folder.log("failed", point=point, batch=batch, label=label, reason=reason)

    def _warn_of_reference(self, outcome: Outcome) -> None:
        """Warn of unknown metrics and broken limits of the reference before other cameras are traced."""
        if outcome.batch == 0:
            warn_caller(map(UserWarning, unknown_of_reference(outcome)))
        if not self.plan.scenes:
            warn_caller(map(UserWarning, beyond_limits(table_of(self.plan, self.outcomes, {}))))

    def _say(self, units: list[tuple[int, int]]) -> None:
        if self.progress is None:
            return
        cameras = [
            self.plan.cameras_of(self.plan.points[point])
            for point, batch in units
            if (point, batch) not in self.outcomes
        ]
        size = sum(cameras) / len(cameras) * self.new / self.cameras if cameras and self.cameras else 1.0
        best, worst = self._ends()
        seconds = time.perf_counter() - self.began
        failed = len({point for (point, _), outcome in self.outcomes.items() if outcome.fault} | set(self.faults))
        self.progress(Progress(len(self.outcomes), len(units), self.new, failed, seconds, best, worst, size))

    def _ends(self) -> tuple[str, str]:
        """Return the best and worst point so far, in words, by the first column with a worse side."""
        column = next((column for column in columns_of(self.plan.metrics) if column.worse), None)
        if column is None:
            return "", ""
        values = [
            (float(outcome.columns[column.name].mean()), point)
            for (point, _), outcome in self.outcomes.items()
            if point and self.plan.points[point].searched is None and column.name in outcome.columns
        ]
        values = [each for each in values if not math.isnan(each[0])]
        if not values:
            return "", ""
        values.sort(key=lambda each: column.harm(each[0]))
        labels = [self.plan.label(self.plan.points[point]) for _, point in (values[0], values[-1])]
        return labels[0], labels[1]

    def table(self) -> Table:
        """Return the table of the finished units."""
        self._missing(self.plan.units)
        return table_of(self.plan, self.outcomes, self.faults)

    def written(self) -> Table:
        """Write table and report of the units finished by this process and others.

        Raises
        ------
        FileError
            The files cannot be written.
        """
        from lfmesh.study.sweeps.report import page

        table = self.table()
        write_inside(self.folder.path, TABLE, table.to_csv())
        write_inside(self.folder.path, PAGE, page(table))
        if efficiency := table.efficiency():
            lines = [f"{row.point.number},{row.seconds!r},{value!r},{error!r}\n" for row, value, error in efficiency]
            text = "point,seconds,efficiency_per_s,efficiency_per_s_stderr\n" + "".join(lines)
            write_inside(self.folder.path, TIMES, text)
        return table

    def take(self, other: Path) -> None:
        """Copy the units of another folder of the same study."""
        if other.resolve() == self.folder.path.resolve():
            return
        source = StudyFolder(other, self.plan)
        for point, batch in self.plan.units:
            try:
                if source.outcome(point, batch) is None or self.folder.unit_path(point, batch).exists():
                    continue
            except FileError as error:
                self.folder.log("unreadable", point=point, batch=batch, reason=str(error))
                continue
            self.folder.keep(point, batch, read_bytes(source.unit_path(point, batch)))
