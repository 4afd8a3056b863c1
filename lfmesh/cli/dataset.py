"""Datasets from one template: `lfmesh dataset`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from lfmesh.cli.application import CASE_FAILED, app, stopped
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.options import Shard, Whole, share_of
from lfmesh.cli.printing import list_files, say_note, say_warnings
from lfmesh.cli.study import LISTED
from lfmesh.errors import LfmeshError
from lfmesh.view.progress import status

if TYPE_CHECKING:
    from lfmesh.study.datasets.dataset import Dataset
    from lfmesh.study.sweeps.progress import Progress


@app.command(
    help_epilogue="""\
More examples:

    lfmesh dataset template.toml -o data/ --count 100 --seed 1
    lfmesh dataset template.toml -o data/ --count 200 --seed 1   100 more
    lfmesh dataset template.toml -o data/ --count 100 --shard 1/3
"""
)
def dataset(
    template: Annotated[Path, Parameter(name="template", help="Dataset file (TOML).")],
    /,
    *,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"], help="Folder of the dataset.")] = None,
    count: Annotated[Whole | None, Parameter(help="Number of items. Overrides the file's.")] = None,
    seed: Annotated[Whole | None, Parameter(help="Random seed. Overrides the file's.")] = None,
    dry_run: Annotated[bool, Parameter(help="List the drawn values, and render nothing.")] = False,
    workers: Annotated[Whole | None, Parameter(help="Number of worker processes; 0 works in this process.")] = None,
    shard: Shard = None,
) -> int:
    """Render many scenes drawn from one template: raw image, views, true depth and camera of each.

    Finished items are kept; the same command continues. Exits with 1 if an item could not be made.
    """
    with defer_interrupt():
        from lfmesh.scene.literals import counted
        from lfmesh.study.datasets.dataset import Dataset

    share = share_of(shard)
    loaded = Dataset.load(template, count=count, seed=seed)
    if dry_run:
        return _plan(loaded)
    if out is None:
        raise LfmeshError("dataset needs --out, the folder to write: lfmesh dataset template.toml -o data/")
    done = 0
    try:
        with status() as say:

            def report(now: "Progress") -> None:
                nonlocal done
                done = now.done
                say(now.in_words("items", "item"))

            made = loaded.make(out, workers=workers, shard=share, progress=report)
    except KeyboardInterrupt:
        return stopped(out, done, "items")
    for number, reason in sorted(made.failed.items()):
        say_note(f"item {number}: {reason}")
    if made.noted:
        say_note(f"{counted(made.noted, 'item')} {'has' if made.noted == 1 else 'have'} notes, which the index holds")
    print(f"{made.done} of {counted(made.count, 'item')} {'is' if made.count == 1 else 'are'} done.")
    list_files([made.index])
    return CASE_FAILED if made.failed else 0


def _plan(loaded: "Dataset") -> int:
    for number in range(min(len(loaded), LISTED)):
        print(f"  {number:>6}  {', '.join(f'{path} = {value}' for path, value in loaded.drawn(number).items())}")
    if len(loaded) > LISTED:
        print(f"  and {len(loaded) - LISTED} more")
    with defer_interrupt():
        from lfmesh.geometry.lens.solved_camera import solved_camera
        from lfmesh.scene.literals import counted
        from lfmesh.transport.build import build
        from lfmesh.transport.checks.foreseen import foreseen

    first = loaded.scene(0)
    say_warnings(foreseen(build(first)), solved_camera(first).report)
    print(f"{counted(len(loaded), 'item')}, all valid: raw images, {', '.join(loaded.file.parts) or 'nothing else'}")
    return 0
