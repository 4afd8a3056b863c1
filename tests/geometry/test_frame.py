"""Rigid frames against scipy's rotations, and the group laws."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lfmesh.geometry.frame import (
    IDENTITY,
    compose,
    directions,
    frame,
    inverse,
    move_direction,
    move_point,
    points,
    rotation,
)

RNG = np.random.default_rng(1)


@pytest.mark.parametrize("tilt", RNG.uniform(-180, 180, size=(5, 3)))
def test_rotates_about_x_then_y_then_z_of_fixed_axes(tilt):
    truth = Rotation.from_euler("xyz", tilt, degrees=True).as_matrix()
    np.testing.assert_allclose(rotation(tilt), truth, atol=5e-16)


def test_quarter_turn_about_z_takes_x_to_y():
    np.testing.assert_allclose(points(frame((0, 0, 90), (1, 2, 3)), [[1, 0, 0]]), [[1, 3, 3]], atol=1e-15)


def test_inverse_undoes_and_compose_applies_the_inner_first():
    outer, inner = frame((10, -50, 70), (1, 2, 3)), frame((-20, 5, 130), (-4, 0.5, 6))
    p = RNG.normal(size=(20, 3))
    np.testing.assert_allclose(compose(inverse(outer), outer), IDENTITY, atol=1e-15)
    np.testing.assert_allclose(points(compose(outer, inner), p), points(outer, points(inner, p)), atol=1e-14)


def test_a_point_and_a_direction_move_between_the_frames_of_a_table():
    table = np.zeros((2, 2, 3, 4))
    table[0, 1] = frame((10, -50, 70), (1, 2, 3))
    table[1, 0] = inverse(table[0, 1])
    for p in RNG.normal(size=(5, 3)):
        there = move_point(table, 0, 1, *p)
        np.testing.assert_allclose(there, points(table[0, 1], p), atol=2e-15)
        np.testing.assert_allclose(move_point(table, 1, 0, *there), p, atol=4e-15)
        turned = move_direction(table, 0, 1, *p)
        np.testing.assert_allclose(turned, directions(table[0, 1], p), atol=1e-15)
        assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(p), rel=1e-15)
