"""The relief of lenslets against areas."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.array.lenslets import Lenslets, lenslets
from lfmesh.geometry.array.relief import CELLS, POINTS, SUMS, fill_relief

Array = NDArray[np.float64]


def relief_of(shape: Lenslets, x: Array, y: Array, box: float, per_mm: float = 0.0) -> Array:
    relief = np.zeros((6, len(x)))
    fill_relief(shape, np.stack([x, y]), box, per_mm, None, np.zeros((CELLS, SUMS)), relief)
    return relief


@pytest.mark.parametrize("hexagonal", [False, True])
def test_round_apertures_pass_their_area(hexagonal: bool) -> None:
    """Of a mask over three by four cells, seen on a grid whose boxes fill the plane."""
    shape = lenslets(Lattice(hexagonal, 1.0, 3, 4), np.array([2.0]), 1.0)._replace(clear_radius=0.45)
    step = 0.04
    across = step * (np.arange(120) - 59.5)
    x, y = (np.ascontiguousarray(each.ravel()) for each in np.meshgrid(across, across))
    relief = relief_of(shape, x, y, step)
    assert relief[3].sum() * step**2 == pytest.approx(12.0 * np.pi * 0.45**2, rel=1e-3)


def test_boxes_at_the_rim_of_an_array_have_the_height_of_the_face_that_their_part_goes_on_as() -> None:
    """A third of the box lies on the lenslet, on a sphere of radius 2 mm; beyond the rim its tangent goes on."""
    shape = lenslets(Lattice(False, 1.0, 1, 1), np.array([2.0]), 1.0)
    box = 0.03
    relief = relief_of(shape, np.array([0.5 + box / 6.0]), np.zeros(1), box)
    assert relief[3, 0] == pytest.approx(1.0 / 3.0, abs=1.0 / POINTS)
    assert relief[5, 0] == pytest.approx(relief[3, 0])
    assert abs(relief[0, 0]) == pytest.approx(2.0 - np.sqrt(4.0 - (0.5 + box / 6.0) ** 2), rel=0.002)
    within = 0.5 - box / 6.0
    assert abs(relief[1, 0]) == pytest.approx(within / np.sqrt(4.0 - within**2), rel=0.02)


def test_a_step_of_half_a_wave_in_the_middle_of_a_box_passes_no_wave() -> None:
    """Two lenslets whose apexes lie beside their centres, one more than the other: half of the box each."""
    shape = lenslets(Lattice(False, 1.0, 2, 1), np.array([2.0]), 1.0)
    shape = shape._replace(decentre=np.array([[0.0, 0.0], [0.02, 0.0]]))
    sag = [2.0 - np.sqrt(4.0 - r**2) for r in (0.5, 0.52)]
    place, box = np.zeros(1), 1e-4
    none = relief_of(shape, place, place, box, np.pi / (sag[1] - sag[0]))
    assert np.hypot(none[3, 0], none[4, 0]) == pytest.approx(0.0, abs=2.0 / POINTS)
    assert none[5, 0] == pytest.approx(1.0)
    whole = relief_of(shape, place, place, box, 2.0 * np.pi / (sag[1] - sag[0]))
    assert np.hypot(whole[3, 0], whole[4, 0]) == pytest.approx(1.0, abs=0.01)
