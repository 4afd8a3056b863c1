"""Corners of a checkerboard are found where exact pictures of it have them, and lists of them are read or refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.study.fits.board_corners import find_corners
from lfmesh.study.fits.board_files import read_corners
from lfmesh.study.fits.corner_fit import fit_corners

Array = NDArray[np.float64]
FINE = 41
"""Points along a sample, of which it is the mean."""


def pictured(size: int, to_board: Array, squares: float = np.inf) -> Array:
    """Return a picture of a board whose squares have side 1; samples are means over their squares.

    `to_board` is a (3, 3) homography from samples to squares, corners at whole numbers; outside ± squares it is grey.
    """
    fine = (np.arange(size * FINE) + 0.5) / FINE - 0.5
    x, y = np.meshgrid(fine, fine)
    i, j, w = np.einsum("ij,jrc->irc", to_board, np.stack([x, y, np.ones_like(x)]))
    i, j = i / w, j / w
    light = (np.floor(i) + np.floor(j)) % 2
    light[np.maximum(np.abs(i), np.abs(j)) > squares] = 0.5
    return np.asarray(light.reshape(size, FINE, size, FINE).mean(axis=(1, 3)))


def turned(degrees: float, side: float, middle: tuple[float, float], slant: float = 0.0) -> Array:
    """Return the homography of a board turned against the samples, its squares `side` samples wide; y is up."""
    angle = np.deg2rad(degrees)
    axes = side * np.array([[np.cos(angle), np.sin(angle)], [np.sin(angle), -np.cos(angle)]])
    to_samples = np.column_stack([np.vstack([axes, [slant, -slant]]), [*middle, 1.0]])
    return np.asarray(np.linalg.inv(to_samples))


def where(to_board: Array, corners: Array) -> Array:
    x, y, w = np.linalg.inv(to_board) @ np.vstack([corners.T, np.ones(len(corners))])
    return np.column_stack([x / w, y / w])


@pytest.mark.parametrize("degrees", [3.0, 17.0, 45.0, 80.0])
def test_a_corner_is_found_to_a_hundredth_of_a_sample(degrees: float) -> None:
    random = np.random.default_rng(int(degrees))
    places = random.uniform(7.5, 8.5, (12, 2))
    views = np.stack([pictured(17, turned(degrees, 4.4, tuple(place))) for place in places])
    angle = np.deg2rad(degrees)
    axes = np.array([[np.cos(angle), np.sin(angle)], [np.sin(angle), -np.cos(angle)]])
    start = places + random.uniform(-0.5, 0.5, places.shape)
    found = fit_corners(views, start, np.broadcast_to(axes, (12, 2, 2)), 4.4)
    assert np.sqrt(np.mean((found.place - places) ** 2)) < 0.01
    assert np.abs(found.place - places).max() < 0.02
    # With noise of 1 % of the contrast the scatter is about that of the Cramér-Rao bound: no larger than 0.02.
    noisy = fit_corners(views + 0.01 * random.normal(size=views.shape), start, np.broadcast_to(axes, (12, 2, 2)), 4.4)
    assert 1e-4 < np.sqrt(np.mean((noisy.place - found.place) ** 2)) < 0.02


@pytest.mark.parametrize(("degrees", "slant"), [(0.0, 0.0), (12.0, 0.02), (-30.0, -0.02)])
def test_corners_are_numbered_and_followed_through_the_views(degrees: float, slant: float) -> None:
    """The board moves by 0.3 samples from view to view, against s and t, as one nearer than the focus does."""
    maps = {
        (v, u): turned(degrees, 5.3, (14.2 - 0.3 * u, 13.7 - 0.3 * v), slant) for v in (-1, 0, 1) for u in (-1, 0, 1)
    }
    views = np.stack([np.stack([pictured(28, maps[v, u], 2.0) for u in (-1, 0, 1)]) for v in (-1, 0, 1)])
    found = find_corners(views, np.ones(views.shape, bool), 2.0, 3, 3)
    assert len(np.unique(found.corner)) == 9
    assert len(found.corner) == 81
    for (v, u), to_board in maps.items():
        own = (found.view == (u, v)).all(axis=1)
        expected = where(to_board, found.board_mm[own] / 2.0)
        assert np.abs(found.sample[own] - expected).max() < 0.03


def test_a_board_of_known_size_may_lack_few_of_its_corners() -> None:
    """A light spot lies on a corner; without a whole column it could be another board's."""
    to_board = turned(12.0, 5.0, (14.0, 14.0))
    picture = pictured(29, to_board, squares=2.5)
    whole = find_corners(picture[None, None], np.ones((1, 1, 29, 29), bool), 1.0)
    count = len(whole.board_mm)
    columns, rows = np.ptp(whole.board_mm, axis=0).astype(int) + 1
    hidden = np.ones((1, 1, 29, 29), bool)
    at = np.rint(whole.sample[np.argmin(np.linalg.norm(whole.board_mm - [0.5, 0.5], axis=1))]).astype(int)
    hidden[0, 0, at[1] - 2 : at[1] + 3, at[0] - 2 : at[0] + 3] = False
    found = find_corners(picture[None, None], hidden, 1.0, int(columns), int(rows))
    assert len(found.board_mm) < count
    for place, board in zip(found.sample, found.board_mm, strict=True):
        same = np.linalg.norm(whole.board_mm - board, axis=1).argmin()
        assert np.abs(whole.sample[same] - place).max() < 0.1
    hidden = np.ones((1, 1, 29, 29), bool)
    for corner in whole.sample[np.argsort(whole.board_mm[:, 0])[: (int(rows) + 1) // 2]]:
        s, t = np.rint(corner).astype(int)
        hidden[0, 0, t - 2 : t + 3, max(s - 2, 0) : s + 3] = False
    with pytest.raises(lf.LfmeshError, match="all except a few of the outer ones"):
        find_corners(picture[None, None], hidden, 1.0, int(columns), int(rows))


@pytest.mark.parametrize(
    ("views", "counts", "words"),
    [
        (np.ones((1, 1, 20, 20)), (None, None), "0 corners of a checkerboard"),
        (np.full((1, 1, 20, 20), np.nan), (None, None), "no sample that the lens fully lights"),
        (np.random.default_rng(3).normal(size=(1, 1, 24, 24)), (None, None), "corners"),
        ((28, turned(5.0, 4.6, (13.5, 13.5))), (9, 8), "columns = 9, rows = 8.*outer ones must be in view"),
        ((40, turned(5.0, 2.1, (20.0, 20.0))), (None, None), "corners|squares"),
    ],
)
def test_a_picture_without_the_board_is_refused_in_one_line(
    views: Array | tuple[int, Array], counts: Any, words: str
) -> None:
    """Of views, or of a board that is pictured."""
    if isinstance(views, tuple):
        views = pictured(*views)[None, None]
    with pytest.raises(lf.LfmeshError, match=words) as refused:
        find_corners(views, np.isfinite(views), 5.0, *counts)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "give a picture, with square_mm, or corners"),
        ({"picture": np.ones((2, 2))}, "square_mm = None"),
        ({"picture": np.ones((2, 2)), "square_mm": -1.0}, "above 0"),
        ({"picture": np.ones((2, 2)), "square_mm": 1.0, "rows": 1}, "rows = 1: must be 2 or more"),
    ],
)
def test_a_board_that_makes_no_sense_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(lf.LfmeshError, match=words):
        lf.Board(**options)


HEAD = "board_x_mm,board_y_mm,view_row,view_column,row,column\n"
LINES = [
    f"{5 * i},{3 * j},{v},{u},{7 + j},{9 - i}\n" for i in range(3) for j in range(3) for v in (-0.5, 0.5) for u in (1,)
]


def test_a_list_of_corners_is_read(tmp_path: Path) -> None:
    path = tmp_path / "corners.csv"
    path.write_text(HEAD + "".join(LINES))
    found = read_corners(path)
    assert len(found.corner) == 18
    assert len(np.unique(found.corner)) == 9
    assert found.board_mm[3].tolist() == [0.0, 3.0]
    assert found.view[3].tolist() == [1.0, 0.5]
    assert found.sample[3].tolist() == [9.0, 8.0]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "column board_x_mm is missing"),
        ("board_x_mm,board_y_mm\n1,2\n", "column view_row is missing"),
        (HEAD, "0 corners of the board"),
        (HEAD + "1,2,0,0,x,3\n", "line 2: row = 'x': must be a finite number"),
        (HEAD + "1,2,0,0,nan,3\n", "line 2: row = 'nan'"),
        (HEAD + "1,2,0\n", "line 2: view_column = None"),
        (HEAD + "".join(f"{i},{2 * i},0,0,1,2\n" for i in range(8)), "lie on one line"),
    ],
)
def test_a_broken_list_of_corners_is_refused_in_one_line(content: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "corners.csv"
    path.write_text(content)
    with pytest.raises(lf.FileError, match=words) as refused:
        read_corners(path)
    assert len(str(refused.value).splitlines()) == 1
    with pytest.raises(lf.FileError, match="cannot be read"):
        read_corners(tmp_path / "none.csv")
