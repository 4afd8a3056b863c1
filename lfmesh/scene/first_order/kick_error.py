"""Error of pictures of extended light, by the Fresnel number of the lenslets: with and without their diffraction.

Tables hold sums of absolute differences from scalar waves over the light: of square lenslets, pixels of a tenth of the
pitch, and a lens with a round pupil at infinity whose micro-images are 0.9 pitches wide. White pictures are seen behind
one lenslet, edges in focus behind the three nearest ones, as the mean of an edge through a lenslet's middle and one
between two lenslets. `tests/scene/first_order/test_kick_error.py` computes them by Fresnel integrals.
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

WHITE_WITHOUT = (
    (0.2551, 0.1226, 0.0713, 0.0422, 0.0231, 0.0124),
    (0.3680, 0.2062, 0.1006, 0.0495, 0.0246, 0.0116),
    (0.4184, 0.2449, 0.1275, 0.0641, 0.0330, 0.0231),
    (0.2929, 0.1275, 0.0508, 0.0251, 0.0127, 0.0068),
    (0.1086, 0.0806, 0.0649, 0.0346, 0.0173, 0.0083),
)
WHITE_WITH = (
    (0.0252, 0.0322, 0.0386, 0.0278, 0.0163, 0.0091),
    (0.0253, 0.0141, 0.0141, 0.0110, 0.0072, 0.0049),
    (0.0253, 0.0127, 0.0064, 0.0032, 0.0016, 0.0008),
    (0.0418, 0.0512, 0.0468, 0.0288, 0.0158, 0.0084),
    (0.0843, 0.1104, 0.0792, 0.0423, 0.0214, 0.0103),
)
"""Of white pictures, by distance and Fresnel number."""


class KickError(NamedTuple):
    """Errors of pictures of extended light, over the light, without diffraction and with that of the lenslets.

    Attributes
    ----------
    white_without, white_with : float
    edge_without, edge_with : float or None
        None where the sensor is not in the lenslets' focal plane.
    """

    white_without: float
    white_with: float
    edge_without: float | None
    edge_with: float | None


def kick_error(fresnel_number: float, distance: float = 1.0) -> KickError | None:
    """Return the errors of a camera's pictures from the tables; None beyond them.

    Errors fall on from the largest Fresnel number of the tables, whose entries then stand for the most.

    Parameters
    ----------
    fresnel_number : float
    distance : float
        Of the sensor behind the lenslets, over their focal length.
    """
    if not fresnel_number >= FRESNEL_NUMBERS[0] or not DISTANCES[0] <= distance <= DISTANCES[-1]:
        return None
    place = np.log(min(fresnel_number, FRESNEL_NUMBERS[-1]))

    def by_number(errors: tuple[float, ...]) -> float:
        return float(np.exp(np.interp(place, np.log(FRESNEL_NUMBERS), np.log(errors))))

    white = [
        float(np.interp(distance, DISTANCES, [by_number(each) for each in table]))
        for table in (WHITE_WITHOUT, WHITE_WITH)
    ]
    edge = [by_number(each) if distance == 1.0 else None for each in (EDGE_WITHOUT, EDGE_WITH)]
    return KickError(white[0], white[1], edge[0], edge[1])
