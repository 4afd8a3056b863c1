"""Ghosts of a launch as table rows: pair by pair, with the error and origin of each power."""

from lfmesh.view.rays.ghosts import GhostPair

GHOST_HEADS = ("ghost", "power in {unit}", "±", "of the sensor's", "origin")


def ghost_cells(pair: GhostPair) -> list[str]:
    """Return a pair as a table row, in the order of `GHOST_HEADS`."""
    origin = "rays" if pair.integrated == 0.0 else "quadrature" if pair.integrated == 1.0 else "quadrature and rays"
    percent = 100.0 * pair.error / pair.power
    return [
        pair.label,
        f"{pair.power:.4g}",
        f"{percent:.1f} %" if percent >= 0.05 else f"{percent:.0e} %",
        f"{100.0 * pair.share:.3g} %",
        origin,
    ]
