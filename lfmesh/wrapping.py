"""Line wrapping at a width that suits terminals."""

import textwrap

COLUMNS = 80
"""Width of text that is printed or written, on a terminal or not."""


def wrapped(text: str) -> str:
    """Break a text into lines of at most `COLUMNS` characters; all but the first are indented."""
    return textwrap.fill(text, COLUMNS, subsequent_indent="  ")
