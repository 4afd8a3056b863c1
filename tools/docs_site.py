"""Extension of Sphinx for this site: keys and commands that its search finds, and tables that fit narrow screens."""

from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

COLUMNS = 3
"""Of the narrowest table with rows that become lists on a narrow screen, as site.css says."""


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the directives `key` and `command`, and the labels of cells."""
    app.add_object_type("key", "key", parse_node=_key, objname="key of a file")
    app.add_object_type("command", "command", objname="command")
    app.connect("doctree-read", label_cells)
    return {"parallel_read_safe": True}


def _key(env: BuildEnvironment, signature: str, node: addnodes.desc_signature) -> str:
    """Show a key without its table: "Sensor.pixels" as "pixels"."""
    key = signature.rsplit(".", 1)[1]
    node += addnodes.desc_name(key, key)
    return signature


def label_cells(app: Sphinx, page: nodes.document) -> None:
    """Put the heading of its column into each cell of a table of many columns, and mark empty cells.

    The style sheet hides the headings where the table is shown as one.
    """
    for table in page.findall(nodes.table):
        heads = [entry.astext() for head in table.findall(nodes.thead) for entry in head.findall(nodes.entry)]
        if len(heads) < COLUMNS:
            continue
        table["classes"].append("wide")
        for row in (row for body in table.findall(nodes.tbody) for row in body.findall(nodes.row)):
            for head, cell in zip(heads, row.children, strict=True):
                assert isinstance(cell, nodes.entry)
                if not cell.astext() and next(cell.findall(nodes.image), None) is None:
                    cell["classes"].append("empty")
                elif head:
                    cell.insert(0, nodes.paragraph(head, head, classes=["cell-label"]))
