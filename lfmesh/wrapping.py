"""Lines of text of a width that terminals have."""

import textwrap

COLUMNS = 80
"""Width of what is printed or written as text, on a terminal or not."""


def wrapped(text: str) -> str:
    """Break a text into lines of at most `COLUMNS` characters; all but the first are indented."""
    return textwrap.fill(text, COLUMNS, subsequent_indent="  ")
