"""Efficiency of blazed profiles, by scalar theory."""

import math


def blaze_share(alpha: float, order: int, levels: int = 0) -> float:
    """Return the share of the transmitted light in an order of a blazed profile; the shares of all orders sum to 1.

    A continuous profile has sinc²(α − m), with sinc x = sin πx / πx; N levels have
    sinc²(m/N) [sin π(α − m) / (N sin(π(α − m)/N))]² (G. J. Swanson, MIT Lincoln Laboratory report 854, 1989).

    Parameters
    ----------
    alpha : float
        Phase over a period of the grating, over 2π: the order with all light, if that is a whole number.
    order : int
        m.
    levels : int
        N; 0 for a continuous profile.
    """
    if levels == 0:
        return _sinc2(alpha - order)
    steps = (alpha - order) / levels
    # From the nearest multiple of N, where both sines vanish.
    near = math.pi * (steps - round(steps))
    bottom = levels * math.sin(near)
    ratio = math.sin(levels * near) / bottom if bottom else 1.0
    return _sinc2(order / levels) * ratio * ratio


def _sinc2(x: float) -> float:
    angle = math.pi * x
    return (math.sin(angle) / angle) ** 2 if angle else 1.0
