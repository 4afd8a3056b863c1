"""The Python reference: pages of assets/docs/python, one a task, with the public names that belong to it.

A page has a line `<!-- names: PART PART ... -->`. A part is a module of lfmesh, a package or a name, such as
`scene.camera` or `files.run.save_white`. Each public name goes to the page with the longest part that it lies in.
"""

import re
from collections import defaultdict
from collections.abc import Mapping

import lfmesh

MARK = re.compile(r"^<!-- names: ([\w. ]+) -->$", re.MULTILINE)

HIDDEN_MEMBERS = "model_config, faults"


def with_names(pages: Mapping[str, str]) -> dict[str, str]:
    """Return the pages with a directive of autodoc for each public name in place of the mark.

    Parameters
    ----------
    pages : dict of str
        Text of each page, by its name.

    Raises
    ------
    ValueError
        A page has no mark, two pages have the same part, or a public name belongs to no page.
    """
    page_of: dict[str, str] = {}
    for page, text in pages.items():
        marks = MARK.findall(text)
        if len(marks) != 1:
            raise ValueError(f"{page}: needs one line <!-- names: ... -->, has {len(marks)}")
        for part in marks[0].split():
            if part in page_of:
                raise ValueError(f"{part} belongs to {page_of[part]} and to {page}: remove it from one")
            page_of[part] = page
    names = defaultdict[str, list[str]](list)
    for name in sorted(set(lfmesh.__all__) - {"__version__"}, key=str.lower):
        names[page_of[_part_of(name, page_of)]].append(name)
    return {page: MARK.sub("\n".join(_directives(names[page])), text) for page, text in pages.items()}


def _part_of(name: str, parts: Mapping[str, str]) -> str:
    """Return the longest of the parts that a public name lies in."""
    words = [*getattr(lfmesh, name).__module__.split(".")[1:], name]
    for end in range(len(words), 0, -1):
        if (part := ".".join(words[:end])) in parts:
            return part
    raise ValueError(f"lf.{name}, of {'.'.join(words)}, belongs to no page of assets/docs/python")


def _directives(names: list[str]) -> list[str]:
    lines = ["## Names", "", "```{eval-rst}", ".. currentmodule:: lfmesh", ""]
    for name in names:
        lines += [*_directive(name), ""]
    return [*lines, "```"]


def _directive(name: str) -> list[str]:
    thing = getattr(lfmesh, name)
    if not isinstance(thing, type):
        return [f".. autofunction:: {name}"]
    if issubclass(thing, Exception):
        return [f".. autoexception:: {name}"]
    return [f".. autoclass:: {name}", "   :members:", f"   :exclude-members: {HIDDEN_MEMBERS}"]
