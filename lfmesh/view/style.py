"""Common style of figures on paper: ink, colours for every eye and for grey, fonts, reproducible files."""

from typing import Any

INK, GREY, PALE = "#222222", "#666666", "#aaaaaa"

FIELD_COLOURS = ("#1b3f7a", "#3fa88b", "#b4541a")
"""Axis, zone and edge of the field: dark, light and medium when printed in grey."""

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
"""Common matplotlib settings; SVG keeps text as text."""
