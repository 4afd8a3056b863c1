"""Splitter of CODE V sequence files into commands: line ends and `;`, continuation lines, comments and quotes."""

import re
from collections.abc import Iterator


def commands(lines: list[str]) -> Iterator[tuple[int, list[str]]]:
    """Yield the first line number (from 1) and the words of each command; quoted words keep a quote."""
    held, start = "", 0
    for at, line in enumerate(lines, 1):
        text = _without_comment(line).rstrip()
        start = start if held else at
        if text.endswith("&"):
            held += text[:-1] + " "
            continue
        for part in _split(held + text):
            words = re.findall(r"'[^']*'?|\"[^\"]*\"?|[^\s'\"]+(?:'[^']*')?", part)
            if words:
                yield start, words
        held = ""


def _without_comment(line: str) -> str:
    quote = ""
    for i, sign in enumerate(line):
        if quote:
            quote = "" if sign == quote else quote
        elif sign == "!":
            return line[:i]
        elif sign in "'\"" and (i == 0 or line[i - 1].isspace()):
            quote = sign
    return line


def _split(text: str) -> list[str]:
    """Split at semicolons outside quotes."""
    return re.findall(r"(?:'[^']*'?|\"[^\"]*\"?|[^;'\"])+", text)
