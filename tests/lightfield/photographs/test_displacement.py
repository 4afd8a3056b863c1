"""Displacements of dots between two pictures: known shifts, known noise, and z-tests of the stated errors."""

from collections.abc import Callable

import numpy as np
import pytest

from lfmesh.lightfield.photographs.displacement import MARGIN, Displacement, displacements, window_centres

Array = np.ndarray
Field = Callable[[Array, Array], tuple[Array, Array]]

SIZE, WINDOW, REACH = 130, 21, 4

APART = WINDOW + 6
"""Distance of windows without a common sample, smoothing included."""

ROUNDS = 12

SIGMAS = 4.0
"""Level of each z-test: 6e-5."""


def constant(x: Array, y: Array) -> tuple[Array, Array]:
    return 1.37 + 0.0 * x, -0.61 + 0.0 * y


def linear(x: Array, y: Array) -> tuple[Array, Array]:
    return 0.5 + 0.01 * (x - 60.0), 0.3 - 0.006 * (x - 60.0) + 0.004 * (y - 60.0)


def curved(x: Array, y: Array) -> tuple[Array, Array]:
    return 1.2 * np.sin(x / 24.0), np.cos(y / 30.0 + x / 40.0)


def dots(field: Field | None = None) -> Array:
    """Return a picture of random Gaussian dots that shows the pattern's point p + d(p) at p."""
    random = np.random.default_rng(7)
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float64)
    shift = field(x, y) if field is not None else (0.0, 0.0)
    picture = np.zeros((SIZE, SIZE))
    for at_x, at_y in random.uniform(-8.0, SIZE + 8.0, (1100, 2)):
        picture += np.exp(-0.5 * ((x + shift[0] - at_x) ** 2 + (y + shift[1] - at_y) ** 2) / 1.3**2)
    return picture


REFERENCE = dots()


def measured(run: Array, sigma: float, seed: int = 0, step: int = APART, reference: Array = REFERENCE) -> Displacement:
    """Return the displacements of two pictures with noise of their own."""
    random = np.random.default_rng(seed)
    noisy = [each + sigma * random.standard_normal(each.shape) for each in (run, reference)]
    known = np.full(run.shape, sigma)
    centres = (window_centres(SIZE, WINDOW, step),) * 2
    return displacements((noisy[0], noisy[1]), (known, known), centres, window=WINDOW, reach=REACH)


def truth(field: Field, step: int = APART) -> Array:
    at = window_centres(SIZE, WINDOW, step).astype(np.float64)
    return np.stack(field(*np.meshgrid(at, at)), axis=-1)


@pytest.mark.parametrize("field", [constant, linear, curved])
def test_errors_are_those_of_the_noise(field: Field) -> None:
    run, right = dots(field), truth(field)
    z, squares = [], []
    for seed in range(ROUNDS):
        found = measured(run, 0.06, seed)
        of_noise = found.error / np.maximum(found.misfit, 1.0)[..., None]
        z.append((found.shift - right) / of_noise)
        squares.append(found.misfit**2)
    number = np.size(z)
    assert number > 300
    assert (np.abs(np.mean(z, axis=(0, 1, 2))) < SIGMAS / np.sqrt(number / 2)).all()
    assert abs(np.mean(np.square(z)) - 1.0) < SIGMAS * np.sqrt(2.0 / number)
    assert abs(np.mean(squares) - 1.0) < SIGMAS * np.std(squares) / np.sqrt(np.size(squares))


def test_gain_and_offset_of_the_picture_do_not_displace() -> None:
    run = dots(constant)
    plain, brighter = measured(run, 0.0), measured(3.0 * run + 2.0, 0.0)
    assert np.allclose(plain.shift, brighter.shift, rtol=0.0, atol=1e-6)
    assert np.abs(plain.shift - truth(constant)).max() < 0.01


def test_a_displacement_beyond_reach_is_unknown() -> None:
    found = measured(dots(lambda x, y: (REACH + 1.5 + 0.0 * x, 0.0 * y)), 0.02)
    assert np.isnan(found.shift).all()
    assert np.isnan(found.error).all()


def test_pictures_without_texture_are_unknown() -> None:
    flat = np.ones((SIZE, SIZE))
    assert np.isnan(measured(flat, 0.0, reference=flat).shift).all()


@pytest.mark.parametrize("window", [9, WINDOW])
def test_pictures_of_noise_alone_are_unknown(window: int) -> None:
    """Of many shifts one makes even noise look alike."""
    known = np.ones((SIZE, SIZE))
    pair = np.random.default_rng(4).standard_normal((2, SIZE, SIZE))
    centres = (window_centres(SIZE, window, window),) * 2
    found = displacements((pair[0], pair[1]), (known, known), centres, window=window, reach=REACH)
    assert found.shift.size > 20
    assert np.isnan(found.shift).all()
    assert np.isnan(found.error).all()


def test_a_window_unlike_all_windows_beside_is_unknown() -> None:
    """A false match, as between like dots: a part of the pattern that is found three samples away in one window."""
    run, row = REFERENCE.copy(), window_centres(SIZE, WINDOW, APART)[2]
    near = slice(row - WINDOW // 2 - MARGIN, row + WINDOW // 2 + MARGIN + 1)
    run[near, near] = np.roll(REFERENCE, 3, axis=1)[near, near]
    found = measured(run, 1e-3)
    assert np.argwhere(np.isnan(found.shift[..., 0])).tolist() == [[2, 2]]
    # Where half of the picture moves by as much, the windows agree.
    run[: SIZE // 2] = np.roll(REFERENCE, 3, axis=1)[: SIZE // 2]
    run[SIZE // 2 :] = REFERENCE[SIZE // 2 :]
    upper = measured(run, 1e-3).shift[0, 1:-1]
    np.testing.assert_allclose(upper, [[-3.0, 0.0]] * len(upper), atol=0.02)


def test_unknown_samples_spoil_no_others() -> None:
    """Windows that hold many of them are unknown; others differ by less than their errors."""
    run = dots(linear)
    holed = run.copy()
    holed[:60, :60] = np.nan
    whole, part = measured(run, 0.02, step=8), measured(holed, 0.02, step=8)
    far = window_centres(SIZE, WINDOW, 8) >= 60 + WINDOW // 2 + MARGIN
    near = window_centres(SIZE, WINDOW, 8) < 60 - WINDOW // 2
    assert far.any()
    assert near.any()
    assert np.isnan(part.shift[np.ix_(near, near)]).all()
    assert np.allclose(part.shift[far], whole.shift[far], rtol=0.0, atol=1e-3)


def test_a_pattern_that_changes_is_stated_by_the_misfit() -> None:
    """Half of the dots move, the others stay: no displacement explains that."""
    both = 0.5 * (dots(constant) + REFERENCE)
    found = measured(both, 0.02)
    known = np.isfinite(found.misfit)
    assert (found.misfit[known] > 2.0).all()


@pytest.mark.parametrize(("length", "count"), [(WINDOW + 2 * MARGIN - 1, 0), (WINDOW + 2 * MARGIN, 1), (SIZE, 4)])
def test_windows_keep_off_the_border(length: int, count: int) -> None:
    centres = window_centres(length, WINDOW, APART)
    assert len(centres) == count
    if count:
        assert centres[0] - WINDOW // 2 >= MARGIN
        assert centres[-1] + WINDOW // 2 < length - MARGIN
