"""Colours of figures differ on paper too."""

from itertools import combinations

import numpy as np
from matplotlib.colors import to_rgb

from lfmesh.view.style import FIELD_COLOURS

JUST_SEEN = 2.3
"""Difference of L* that is just noticed (Mahy, Van Eycken & Oosterlinck 1994, for colours side by side)."""


def lightness(colour: str) -> float:
    """Return CIE L* of an sRGB colour, by IEC 61966-2-1 and CIE 15."""
    channels = np.array(to_rgb(colour))
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    y = float(linear @ [0.2126, 0.7152, 0.0722])
    return 116.0 * np.cbrt(y) - 16.0


def test_fields_are_told_apart_in_grey_and_seen_on_white_paper() -> None:
    assert lightness("#ffffff") == 100.0
    shades = [lightness(colour) for colour in FIELD_COLOURS]
    assert min(abs(one - other) for one, other in combinations(shades, 2)) > 5.0 * JUST_SEEN
    assert max(shades) < 100.0 - 10.0 * JUST_SEEN
