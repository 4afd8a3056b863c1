"""The ghosts of a launch as the page lists them: pair by pair, with the error and the origin of each power."""

from lfmesh.view.rays.exact_ghosts import refusal
from lfmesh.view.rays.ghosts import GhostPair
from lfmesh.view.rays.paths import Rays

GHOST_HEADS = ("ghost", "power / {unit}", "±", "of the sensor's", "origin")

BY_QUADRATURE = "Origin quadrature: the pair's sequences are integrated over the pupil; ± is the error of that."


def ghost_cells(pair: GhostPair) -> list[str]:
    """Return a pair as a row of the table, in the order of `GHOST_HEADS`."""
    origin = "rays" if pair.integrated == 0.0 else "quadrature" if pair.integrated == 1.0 else "quadrature and rays"
    percent = 100.0 * pair.error / pair.power
    return [
        pair.label,
        f"{pair.power:.4g}",
        f"{percent:.1f} %" if percent >= 0.05 else f"{percent:.0e} %",
        f"{100.0 * pair.share:.3g} %",
        origin,
    ]


def origin_in_words(rays: Rays, *, is_whole: bool) -> str:
    """Say how the powers are had, and why not by quadrature where they are not.

    Parameters
    ----------
    rays : Rays
        Of the launch.
    is_whole : bool
        Whether the filter keeps all of them.
    """
    if rays.field is None:
        why = "they are integrated for rays of field points alone"
    elif (obstacle := refusal(rays.world)) is not None:
        why = obstacle
    elif not is_whole:
        why = "a filter chooses among the rays, and what is integrated over the pupil it cannot divide"
    else:
        return BY_QUADRATURE
    return f"All from the rays, ± the standard error: {why}."
