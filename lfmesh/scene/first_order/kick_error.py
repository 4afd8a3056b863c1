"""Error of pictures of extended light, by the Fresnel number of the lenslets: with and without their diffraction.

Tables hold sums of absolute differences from scalar waves over the light: of square or hexagonal lenslets, pixels of a
tenth of the pitch, and a lens with a round pupil at infinity whose micro-images are 0.9 pitches wide. White pictures
are those of a wide array; in its focal plane waves of neighbours leave no trace in them, and diffraction of each
lenslet is all. Edges in focus are seen behind the three nearest lenslets, as the mean of an edge through a lenslet's
middle and one between two lenslets; of hexagons they are not known. The tests of this module compute the tables by
Fresnel integrals.
"""

from typing import NamedTuple

import numpy as np

FRESNEL_NUMBERS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Square of half a lenslet's width, over wavelength and distance from the sensor."""

DISTANCES = (0.7, 0.85, 1.0, 1.2, 1.4)
"""Of the sensor behind the lenslets, over their focal length."""

EDGE_WITHOUT = (0.5145, 0.2984, 0.1603, 0.0802, 0.0550, 0.0422)
EDGE_WITH = (0.0815, 0.0573, 0.0384, 0.0236, 0.0139, 0.0082)
"""Of edges in focus, by the Fresnel number, with the sensor in the lenslets' focal plane."""

SQUARES_WITHOUT = (
    (0.2576, 0.1235, 0.0717, 0.0423, 0.0231, 0.0121),
    (0.3715, 0.2077, 0.1010, 0.0499, 0.0245, 0.0118),
    (0.4226, 0.2468, 0.1281, 0.0650, 0.0330, 0.0166),
    (0.2966, 0.1291, 0.0513, 0.0252, 0.0129, 0.0068),
    (0.1101, 0.0812, 0.0657, 0.0346, 0.0171, 0.0084),
)
SQUARES_WITH = (
    (0.0147, 0.0304, 0.0406, 0.0287, 0.0166, 0.0091),
    (0.0120, 0.0109, 0.0158, 0.0117, 0.0076, 0.0046),
    (0.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000),
    (0.0312, 0.0471, 0.0447, 0.0278, 0.0167, 0.0088),
    (0.0759, 0.1072, 0.0778, 0.0419, 0.0211, 0.0104),
)
HEXAGONS_WITHOUT = (
    (0.2323, 0.1204, 0.0663, 0.0379, 0.0193, 0.0097),
    (0.3232, 0.1978, 0.0996, 0.0483, 0.0241, 0.0121),
    (0.3760, 0.2450, 0.1361, 0.0702, 0.0356, 0.0180),
    (0.2730, 0.1344, 0.0549, 0.0314, 0.0167, 0.0085),
    (0.1307, 0.0508, 0.0619, 0.0325, 0.0164, 0.0081),
)
HEXAGONS_WITH = (
    (0.0093, 0.0190, 0.0363, 0.0263, 0.0150, 0.0079),
    (0.0072, 0.0074, 0.0149, 0.0158, 0.0106, 0.0061),
    (0.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000),
    (0.0179, 0.0334, 0.0410, 0.0306, 0.0179, 0.0095),
    (0.0427, 0.0778, 0.0694, 0.0377, 0.0197, 0.0101),
)
WHITE = {"square": (SQUARES_WITHOUT, SQUARES_WITH), "hexagonal": (HEXAGONS_WITHOUT, HEXAGONS_WITH)}
"""Of white pictures, by distance and Fresnel number, of each layout of lenslets."""


class KickError(NamedTuple):
    """Errors of pictures of extended light, over the light, without diffraction and with that of the lenslets.

    Attributes
    ----------
    white_without, white_with : float
    edge_without, edge_with : float or None
        None where edges in focus are not behind lenslets in focus, and of hexagons.
    """

    white_without: float
    white_with: float
    edge_without: float | None
    edge_with: float | None


def kick_error(
    fresnel_number: float, distance: float = 1.0, *, layout: str = "square", in_focus: bool = True
) -> KickError | None:
    """Return the errors of a camera's pictures from the tables; None beyond them.

    Errors fall on from the largest Fresnel number of the tables, whose entries then stand for the most.

    Parameters
    ----------
    fresnel_number : float
    distance : float
        Of the sensor behind the lenslets, over their focal length.
    layout : str
        Of the lenslets, "square" or "hexagonal".
    in_focus : bool
        The lenslets image the pupil, sharp to a pixel: the errors of edges are known, of squares.
    """
    if not fresnel_number >= FRESNEL_NUMBERS[0] or not DISTANCES[0] <= distance <= DISTANCES[-1]:
        return None
    number = min(fresnel_number, FRESNEL_NUMBERS[-1])

    def by_number(errors: tuple[float, ...]) -> float:
        # Errors fall about as the inverse of the number.
        return float(np.interp(np.log(number), np.log(FRESNEL_NUMBERS), np.multiply(errors, FRESNEL_NUMBERS))) / number

    white = [float(np.interp(distance, DISTANCES, [by_number(each) for each in table])) for table in WHITE[layout]]
    known = in_focus and layout == "square"
    edge = [by_number(each) if known else None for each in (EDGE_WITHOUT, EDGE_WITH)]
    return KickError(white[0], white[1], edge[0], edge[1])
