"""HTML from templates: Jinja2 escapes every value that is not markup."""

from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined


def filled(template: Path, **values: Any) -> str:
    """Return a template with values in it.

    Parameters
    ----------
    template : Path
        A file of Jinja2, HTML.
    **values
        Text is escaped; what is markup already has to be `markupsafe.Markup`.
    """
    return _environment(template.parent).get_template(template.name).render(values)


@cache
def _environment(folder: Path) -> Environment:
    loader = FileSystemLoader(folder)
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
