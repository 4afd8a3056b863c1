"""Run the example notebooks and keep their output, small and without what changes from run to run.

    .venv/bin/python tools/make_notebooks.py [NAME ...]

Look at each afterwards: the text between the cells speaks of what they show.
"""

import base64
import io
import sys
import tempfile
import time
from pathlib import Path

import nbformat
import PIL.Image
from nbclient import NotebookClient

from lfmesh.view.progress import STATUS_CLASS

FOLDER = Path(__file__).resolve().parents[1] / "assets" / "notebooks"

COLOURS = 64
"""Of a figure that is kept."""

SECONDS = 600
"""For a cell; the first ones may have to compile."""


def executed(path: Path) -> nbformat.NotebookNode:
    """Return a notebook with the output of all of its cells, run in a folder of its own.

    Raises
    ------
    nbclient.exceptions.CellExecutionError
        A cell failed.
    """
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=SECONDS, resources={"metadata": {"path": folder}}).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if "outputs" in cell:
            cell.outputs = [output for output in cell.outputs if not is_status(output)]
        for output in cell.get("outputs", []):
            shown = output.get("data", {})
            if "<iframe" in shown.get("text/html", ""):  # a scene that turns is too large to keep
                shown.pop("text/html")
            if "text/html" in shown or "image/jpeg" in shown:  # they hold the same picture
                shown.pop("image/png", None)
            if "image/png" in shown:
                shown["image/png"] = reduced(shown["image/png"])
    return notebook


def is_status(output: nbformat.NotebookNode) -> bool:
    """Tell whether an output is the progress of a job, which a faster machine does not show."""
    return STATUS_CLASS in output.get("data", {}).get("text/html", "")


def reduced(picture: str) -> str:
    """Return a PNG, as base64, in few colours."""
    content = io.BytesIO()
    opened = PIL.Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
    opened.quantize(COLOURS, dither=PIL.Image.Dither.NONE).save(content, format="PNG", optimize=True)
    return base64.b64encode(content.getvalue()).decode("ascii")


def main(names: list[str]) -> None:
    for path in sorted(FOLDER.glob("*.ipynb")):
        if names and path.stem not in names:
            continue
        begun = time.perf_counter()
        nbformat.write(executed(path), path)
        print(f"{path.name}: {time.perf_counter() - begun:.0f} s, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
