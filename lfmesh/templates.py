"""HTML from templates: Jinja2 escapes every value that is not markup."""

from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined


def filled(template: Path, **values: Any) -> str:
    """Fill a template with values.

    Parameters
    ----------
    template : Path
        HTML file of Jinja2.
    **values
        Text is escaped; finished markup must be a `markupsafe.Markup`.
    """
    return _environment(template.parent).get_template(template.name).render(values)


@cache
def _environment(folder: Path) -> Environment:
    loader = FileSystemLoader(folder)
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
