"""Self-contained HTML page of an optimisation: figures, variables, drawings of both cameras."""

from pathlib import Path

import lfmesh
from lfmesh.errors import LfmeshError
from lfmesh.scene import Scene
from lfmesh.study.optimise.design_file import Constraint
from lfmesh.study.optimise.optimise import Optimum, TermResult, shown_number
from lfmesh.templates import filled
from lfmesh.view.layout.content import layout
from lfmesh.view.layout.figure import encoded
from lfmesh.view.pictures import file_url

TEMPLATE = Path(__file__).parents[1] / "templates" / "optimum.html"


def page(found: Optimum) -> str:
    """Return the HTML page."""
    name = found.first.title or "a camera"
    return filled(
        TEMPLATE,
        title=f"Optimised camera: {name}",
        made_by=f"lfmesh {lfmesh.__version__}",
        effort=found.effort,
        in_short=_in_short(found),
        missed=found.missed,
        figures=[_cells(each) for each in (*found.terms, *found.constraints)],
        variables=[
            [each.variable.title, shown_number(each.before), shown_number(each.after), each.note]
            for each in found.variables
        ],
        cameras=[*_drawn("before", found.first), *_drawn("after", found.scene)],
        notes=found.notes,
    )


def _in_short(found: Optimum) -> list[str]:
    left = found.merit_left
    lines = [f"Merit function: {found.merit_before:.6g} before, {left:.6g} after (smaller is better)."]
    if left and len(found.terms) > 1:
        worst = max(found.terms, key=lambda each: each.share_left)
        share = worst.share_left / left
        reached = _with_unit(worst.after, worst.goal.unit)
        lines.append(f"{100.0 * share:.0f} % of it comes from {worst.goal.title}, which is {reached}.")
    if found.constraints:
        lines.append(f"{len(found.constraints) - len(found.violated)} of {len(found.constraints)} limits are kept.")
    ends = [each.variable.title for each in found.variables if each.note.startswith("at the")]
    if ends:
        lines.append(f"At an end of their ranges: {', '.join(ends)}; wider ranges may give better cameras.")
    return lines


def _with_unit(value: float, unit: str) -> str:
    return f"{value:.6g} {unit}".rstrip()


def _cells(result: TermResult) -> list[str]:
    goal = result.goal
    is_limit = isinstance(goal, Constraint)
    asked = goal.in_words if isinstance(goal, Constraint) else f"{goal.wanted:.6g}"
    shares = ["", ""] if is_limit else [f"{share:.6g}" for share in (result.share_before, result.share_left)]
    return [goal.described, goal.unit, asked, f"{result.before:.6g}", f"{result.after:.6g}", *shares]


def _drawn(words: str, scene: Scene) -> list[tuple[str, str]]:
    """Return a camera's layout as an image URL with its caption; nothing if it cannot be drawn."""
    try:
        return [(words, file_url(encoded(layout(scene), "svg"), "image/svg+xml"))]
    except LfmeshError:
        return []
