"""The figure of speed against error on the site, measured by this build as `lfmesh accuracy` measures."""

from pathlib import Path

import make_pictures

import lfmesh as lf
from lfmesh.accuracy.report import measure

SCENE = "scenes/first_light.toml"
PICTURE = "accuracy.png"


def accuracy_picture(kept: Path, program: str, *, quick: bool) -> Path | None:
    """Return the figure; None if nothing may be measured and none is kept.

    Parameters
    ----------
    kept : Path
        Folder of earlier reports, by digest of the program.
    program : str
        Digest of the program.
    quick : bool
        Measure nothing.
    """
    folder = kept / program
    if not (folder / PICTURE).is_file():
        if quick:
            return None
        print("accuracy", flush=True)
        measure(lf.load(lf.asset_path(SCENE))).write(folder)
        make_pictures.from_report(folder, folder / PICTURE)
    return folder / PICTURE
