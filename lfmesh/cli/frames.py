"""Sequences of frames of moving particles: `lfmesh frames`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.options import Overrides, SceneFile, Whole, overridden
from lfmesh.cli.printing import list_files, say_note
from lfmesh.view.progress import progress


@app.command(
    help_epilogue="""\
More examples:

    lfmesh frames particles.toml -o film --frames 10
"""
)
def frames(
    scene: SceneFile,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Folder to write: a run folder for each frame.")],
    count: Annotated[Whole, Parameter(name="--frames", help="Number of frames.")] = 2,
    overrides: Overrides | None = None,
) -> int:
    """Render frames of moving particles, with the true places and vectors beside them.

    Writes the run folders frame_0, frame_1, ... and, for each step, vectors_0.csv, ...: place and displacement of every
    particle, in mm, in the order of the scene. Each frame has random numbers of its own.
    """
    from lfmesh.scene import load
    from lfmesh.scene.particle_frames import displaced, particle_vectors, write_vectors

    first = overridden(load(scene), overrides).pinned()
    scenes = [displaced(first, number) for number in range(max(count, 1))]
    # Faults in the particles' files are reported before anything is written.
    moves = [particle_vectors(frame) for frame in scenes[:-1]]
    with defer_interrupt():
        from lfmesh.files import run
        from lfmesh.waves.render import render

    folders = [out / f"frame_{number}" for number in range(len(scenes))]
    for folder in folders:
        run.prepare(folder)
    for number, (frame, folder) in enumerate(zip(scenes, folders, strict=True)):
        seeded = frame.changed({"transport.seed": frame.transport.seed + number})
        with run.rendering(folder):
            with progress() as report:
                image = render(seeded, progress=report)
            if not image.complete:
                say_note(f"stopped in frame {number}; the frames before it are complete")
                raise KeyboardInterrupt
            run.save(image, folder)
        if number < len(moves):
            write_vectors(out / f"vectors_{number}.csv", *moves[number])
    list_files([*folders, *(out / f"vectors_{number}.csv" for number in range(len(moves)))])
    return 0
