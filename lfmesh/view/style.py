"""One style of the figures on paper: ink, colours that differ for every eye and in grey, fonts, repeatable files."""

from typing import Any

INK, GREY, PALE = "#222222", "#666666", "#aaaaaa"

FIELD_COLOURS = ("#1b3f7a", "#3fa88b", "#b4541a")
"""Axis, zone and edge of the field: dark, light and middling where they are printed in grey."""

PAPER: Any = {
    "font.family": ["DejaVu Sans", "sans-serif"],
    "svg.fonttype": "none",
    "svg.hashsalt": "lfmesh",
    "pdf.fonttype": 42,
    "text.parse_math": False,
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
}
"""matplotlib's settings of all of them; SVG keeps its text as text."""
