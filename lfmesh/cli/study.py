"""Studies of many cameras: `lfmesh study`, `lfmesh study merge`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from lfmesh.cli.application import CASE_FAILED, app, stopped
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.options import Dask, Shard, Whole, share_of
from lfmesh.cli.printing import list_files, say_note
from lfmesh.errors import LfmeshError
from lfmesh.view.progress import status
from lfmesh.wrapping import wrapped

if TYPE_CHECKING:
    from lfmesh.study.sweeps.progress import Progress
    from lfmesh.study.sweeps.study import Study
    from lfmesh.study.sweeps.table import Table

study_app = App(
    name="study",
    help="Many cameras: errors and parameters against metrics, with error bars.",
    help_epilogue="""\
More examples:

    lfmesh study study.toml --dry-run
    lfmesh study study.toml -o out/
    lfmesh study study.toml -o out/          again: continues where it stopped
    lfmesh study study.toml -o a/ --shard 1/3
    lfmesh study merge study.toml a/ b/ c/ -o out/
    lfmesh study study.toml -o out/ --dask tcp://10.0.0.1:8786
""",
)
app.command(study_app)

StudyPath = Annotated[Path, Parameter(name="study", help="Study file (TOML); with --template a scene file.")]


@study_app.default
def study(
    study: StudyPath,
    /,
    *,
    out: Annotated[
        Path | None,
        Parameter(name=["--out", "-o"], help="Folder of the study; with --template, the study file to write."),
    ] = None,
    dry_run: Annotated[bool, Parameter(help="List points, memory and time, and compute nothing.")] = False,
    template: Annotated[
        str | None,
        Parameter(help="Write a study file to start from: assembly, manufacturing, packets-and-splits or sensor."),
    ] = None,
    workers: Annotated[Whole | None, Parameter(help="Number of worker processes; 0 works in this process.")] = None,
    dask: Dask = None,
    shard: Shard = None,
    parquet: Annotated[bool, Parameter(help="Also write the table as Parquet.")] = False,
) -> int:
    """Compare many cameras with a reference: table.csv, report.html and a log in a folder.

    Finished points are kept; the same command continues. Exits with 1 if a point could not be traced.
    """
    if template is not None:
        return _write_template(template, study, out)
    with defer_interrupt():
        from lfmesh.study.sweeps.study import Study

    loaded = Study.load(study)
    if dry_run:
        return _plan(loaded, workers)
    if out is None:
        raise LfmeshError("study needs --out, the folder to write: lfmesh study study.toml -o out/")
    done = 0
    try:
        with status() as say:

            def report(now: "Progress") -> None:
                nonlocal done
                done = now.done
                say(now.in_words("units", "point"))

            table = loaded.run(out, workers=workers, dask=dask, shard=share_of(shard), progress=report)
    except KeyboardInterrupt:
        return stopped(out, done, "units")
    return _report(table, out, parquet)


@study_app.command(help_epilogue="")
def merge(
    study: StudyPath,
    /,
    *folders: Annotated[Path, Parameter(help="Folders of the shares.")],
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Folder for the whole study.")],
    parquet: Annotated[bool, Parameter(help="Also write the table as Parquet.")] = False,
) -> int:
    """Put the shares of a study together; the table is bitwise that of a study that was not divided."""
    with defer_interrupt():
        from lfmesh.study.sweeps.study import Study

    return _report(Study.load(study).merge(folders, out), out, parquet)


def _write_template(name: str, scene: Path, out: Path | None) -> int:
    with defer_interrupt():
        from lfmesh.scene import load
        from lfmesh.study.tolerances.error_modes import template_text

    if out is None:
        raise LfmeshError("--template needs --out, the study file to write: -o study.toml")
    from lfmesh.files.whole import write_whole

    write_whole(out, template_text(name, load(scene), scene, out.parent))
    list_files([out])
    return 0


def _plan(loaded: "Study", workers: int | None) -> int:
    from lfmesh.files.words import duration
    from lfmesh.scene.literals import counted, plain
    from lfmesh.study.sweeps.probe import probe

    plan = loaded.plan
    for point in plan.points[:LISTED]:
        print(f"  {point.number:>6}  {plan.label(point)}")
    if len(plan.points) > LISTED:
        print(f"  and {len(plan.points) - LISTED} more")
    found = probe(plan, workers)
    for words in found.unknown:
        say_note(words)
    print(
        f"{counted(found.points, 'point')}, {counted(found.units, 'unit')} in {found.workers} "
        f"process{'' if found.workers == 1 else 'es'}, {', '.join(plan.metrics)}: about {duration(found.seconds)} "
        f"({duration(found.start_seconds)} to start, {plain(found.unit_seconds, 2)} s per camera in one process), "
        f"{plain(found.bytes / 1e9, 2)} GB of memory"
    )
    return 0


LISTED = 40
"""Number of points that a dry run lists."""


def _report(table: "Table", out: Path, parquet: bool) -> int:
    from lfmesh.scene.literals import counted
    from lfmesh.study.sweeps.sentences import largest_changes, metrics_not_known, yield_in_words
    from lfmesh.study.sweeps.study import PAGE, PARQUET, TABLE

    files = [out / TABLE, out / PAGE]
    if parquet:
        from lfmesh.files.folder import write_inside

        write_inside(out, PARQUET, table.to_parquet())
        files.append(out / PARQUET)
    for row in table.failed:
        if row.fault != "not done":
            say_note(f"point {row.point.number}, {table.plan.label(row.point)}: {row.fault}")
    for words in metrics_not_known(table):
        say_note(words)
    missing = sum(row.fault == "not done" for row in table.rows)
    done = len(table.rows) - len(table.failed)
    others = f", {missing} of other shares {'is' if missing == 1 else 'are'} not" if missing else ""
    total = len(table.rows)
    print(f"{done} of {counted(total, 'point')} {'is' if total == 1 else 'are'} done{others}.")
    for line in (*yield_in_words(table), *largest_changes(table)):
        print(wrapped(line))
    list_files(files)
    return CASE_FAILED if len(table.failed) > missing else 0
