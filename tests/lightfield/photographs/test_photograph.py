"""Photographs with every place in focus, from stacks made by hand."""

import numpy as np

from lfmesh.lightfield.photographs.photograph import FocalStack, Photograph, all_in_focus


def photograph(mean: np.ndarray, distance_mm: float, coverage: np.ndarray | None = None) -> Photograph:
    data = mean[..., None]
    return Photograph(data, 0.0 * data, distance_mm, 4.0, 1.0, (587.6,), "W per pixel", coverage=coverage)


def test_the_border_of_what_is_known_is_not_taken_for_sharp() -> None:
    """One photograph is even and half unknown, the other one faintly textured all over: it alone has texture."""
    texture = 1.0 + 0.01 * np.random.default_rng(4).normal(size=(30, 30))
    even = np.ones((30, 30))
    even[:, 15:] = np.nan
    for stack in ((even, texture), (texture, even)):
        found = all_in_focus(FocalStack(tuple(photograph(each, k + 1.0) for k, each in enumerate(stack))))
        np.testing.assert_array_equal(found.mean[..., 0], texture)


def test_a_sample_is_unknown_only_where_all_photographs_leave_it_so() -> None:
    draw = np.random.default_rng(5)
    pictures = []
    for _ in range(3):
        picture = draw.normal(size=(24, 24))
        picture[draw.random((24, 24)) < 0.3] = np.nan
        pictures.append(picture)
    found = all_in_focus(FocalStack(tuple(photograph(each, k + 1.0) for k, each in enumerate(pictures))))
    np.testing.assert_array_equal(np.isnan(found.mean[..., 0]), np.isnan(pictures).all(axis=0))


def test_a_plane_seen_by_few_views_is_no_sharper() -> None:
    """Few views show any plane without blur. There the plane of the nearest compared sample counts."""
    draw = np.random.default_rng(6)
    right, wrong = 1.0 + 0.1 * draw.normal(size=(2, 30, 30))
    wrong *= np.where(np.arange(30) < 20, 0.1, 10.0)
    few = np.where(np.arange(30) < 20, 1.0, 0.2) * np.ones((30, 1))
    stack = FocalStack((photograph(right, 1.0, np.ones((30, 30))), photograph(wrong, 2.0, few)))
    found = all_in_focus(stack)
    np.testing.assert_array_equal(found.mean[..., 0], right)
    np.testing.assert_array_equal(found.distance_mm[:, :20], 1.0)
    assert np.isnan(found.distance_mm[:, 20:]).all()
    assert "planes from 1 to 1 mm" in repr(found)
