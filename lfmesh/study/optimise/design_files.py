"""Files of an optimised camera: its scene, and the outcome as JSON, text and HTML page."""

import json
from pathlib import Path

import lfmesh
from lfmesh.files.inputs import within
from lfmesh.files.json_values import plain_json
from lfmesh.study.fits.fit_files import write_files
from lfmesh.study.optimise.optimise import Optimum
from lfmesh.study.optimise.optimum_page import page

SCENE, FACTS, TEXT, PAGE = "optimised.toml", "optimum.json", "optimum.txt", "report.html"


def write_optimum(found: Optimum, folder: Path) -> list[Path]:
    """Write ``optimised.toml``, ``optimum.json``, ``optimum.txt`` and ``report.html`` into a folder.

    Returns
    -------
    list of Path

    Raises
    ------
    FileError
        The folder cannot be written.
    """
    facts = {"lfmesh_version": lfmesh.__version__, **found.as_dict()}
    contents: dict[str, str | bytes] = {
        SCENE: within(found.scene, folder).dump_toml(),
        FACTS: json.dumps(plain_json(facts), indent=1, ensure_ascii=False) + "\n",
        TEXT: "\n".join(found.lines()) + "\n",
        PAGE: page(found),
    }
    return write_files(contents, folder)
