"""Checkerboard corners in the views of a light field: found and numbered in the middle view, tracked outwards."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter

from lfmesh.errors import LfmeshError
from lfmesh.scene.literals import plain
from lfmesh.study.fits.corner_fit import FittedCorners, fit_corners

Array = NDArray[np.float64]

SMOOTHING = 1.0
"""Standard deviation, in samples, of the smoothing before the curvature is computed."""

CURVED = 0.25
"""Fraction of the strongest saddle below which candidates are ignored."""

FIRST_REACH = 3.0
"""Half-window of the first fit of a corner, before the corner spacing is known, in samples."""

FIRST_RESIDUAL, RESIDUAL = 0.25, 0.2
"""Residual over contrast above which a candidate is not a corner of four squares."""

CONTRAST = 0.4
"""Fraction of the median contrast below which squares do not belong to the board."""

BESIDE = 0.3
"""Largest distance of a corner from the place predicted by its neighbours, in squares."""

LEAST_SQUARE = 3.0
"""Smallest side of a square, in samples, at which its corners can be resolved."""

LEAST_CORNERS = 6
"""Smallest number of corners: fewer hardly determine the board's six coordinates."""


@dataclass(frozen=True, eq=False)
class BoardCorners:
    """Corners of a board in views.

    Attributes
    ----------
    corner : (n,) int64
        Number of the corner; its places share its errors.
    board_mm : (n, 2) float64
        Position on the upright board, x to the right and y up.
    view : (n, 2) float64
        Column u and row v of the view relative to the middle one, ordered as in `LightField`.
    sample : (n, 2) float64
        Column s and row t in the view, from the centre of the first sample.
    """

    corner: NDArray[np.int64]
    board_mm: Array
    view: Array
    sample: Array

    def __repr__(self) -> str:
        return f"<BoardCorners: {len(np.unique(self.corner))} corners of a board, {len(self.corner)} places in views>"


def find_corners(
    views: Array, usable: NDArray[np.bool_], square_mm: float, columns: int | None = None, rows: int | None = None
) -> BoardCorners:
    """Find the inner corners of a checkerboard, between four squares, in every view.

    Parameters
    ----------
    views : (v, u, t, s) float64
        Views divided by the white image; NaN: unknown.
    usable : (v, u, t, s) bool
        Samples that the lens does not vignette.
    square_mm : float
        Side of a square.
    columns, rows : int, optional
        Corners along x and y of the board. Default: all visible ones.

    Raises
    ------
    LfmeshError
        No board, too few corners, or another number than stated.
    """
    views = np.where(usable, views, np.nan)
    middle = views.shape[0] // 2, views.shape[1] // 2
    places, numbers, steps = _labelled(views[middle])
    numbers = _stated(numbers, columns, rows)
    seen = _followed(views, middle, places, steps)
    v, u, corner = np.nonzero(np.isfinite(seen[..., 0]))
    if len(np.unique(corner)) < LEAST_CORNERS:
        raise LfmeshError(
            f"board: {len(np.unique(corner))} corners lie on samples that the lens fully lights, but "
            f"{LEAST_CORNERS} are needed"
        )
    span = numbers.max(axis=0) + numbers.min(axis=0)
    board_mm = square_mm * (numbers - 0.5 * span)
    halves = 0.5 * (np.array(views.shape[1::-1]) - 1.0)
    return BoardCorners(corner, board_mm[corner], np.column_stack([u, v]) - halves, seen[v, u, corner])


def _labelled(view: Array) -> tuple[Array, NDArray[np.int64], Array]:
    """Return places (n, 2), board columns and rows (n, 2), and steps to the next corners (n, 2, 2), in samples."""
    places, axes = _candidates(view)
    if len(places) < LEAST_CORNERS:
        raise LfmeshError(_too_few(len(places)))
    first = _fit_all(view, places, axes, FIRST_REACH)
    good = np.isfinite(first.place[:, 0]) & (first.residual < FIRST_RESIDUAL)
    good &= np.abs(first.contrast) > CONTRAST * np.median(np.abs(first.contrast[good])) if good.any() else good
    places = _once(first.place[good])
    if len(places) < LEAST_CORNERS:
        raise LfmeshError(_too_few(len(places)))
    numbers, steps = _numbered(places)
    on_board = np.flatnonzero(numbers[:, 0] != OFF)
    if len(on_board) < LEAST_CORNERS:
        raise LfmeshError(_too_few(len(on_board)))
    places, numbers, steps = places[on_board], numbers[on_board], steps[on_board]
    sizes = np.linalg.norm(steps, axis=2)
    if np.median(sizes) < LEAST_SQUARE:
        raise LfmeshError(
            f"board: its squares are {plain(np.median(sizes), 2)} samples wide in a view; they must be "
            f"{LEAST_SQUARE:g} or more: bring it nearer, or use one with larger squares"
        )
    fitted = _fit_all(view, places, steps / sizes[..., None], float(np.median(sizes)))
    sense = np.sign(fitted.contrast) * np.where(numbers.sum(axis=1) % 2, -1.0, 1.0)
    kept = np.isfinite(fitted.place[:, 0]) & (fitted.residual < RESIDUAL) & (sense == np.sign(sense.sum()))
    if kept.sum() < LEAST_CORNERS:
        raise LfmeshError(_too_few(int(kept.sum())))
    return _upright(fitted.place[kept], numbers[kept], steps[kept])


def _too_few(count: int) -> str:
    return (
        f"board: {count} corners of a checkerboard were found in the middle view, but {LEAST_CORNERS} are needed; its "
        f"squares must be {LEAST_SQUARE:g} samples wide or more, sharp, and in the field of the white image"
    )


def _fit_all(view: Array, places: Array, axes: Array, reach: float) -> FittedCorners:
    return fit_corners(np.broadcast_to(view, (len(places), *view.shape)), places, axes, reach)


def _candidates(view: Array) -> tuple[Array, Array]:
    """Return the samples at the strongest saddles, (n, 2), and unit vectors along the edges there, (n, 2, 2)."""
    known = np.isfinite(view)
    if not known.any():
        raise LfmeshError("board: the middle view has no sample that the lens fully lights; check the white image")
    filled = np.where(known, view, np.nanmedian(view))
    ss, tt, st = (gaussian_filter(filled, SMOOTHING, order=order, mode="nearest") for order in ((0, 2), (2, 0), (1, 1)))
    saddle = st**2 - ss * tt
    t, s = np.nonzero((saddle == maximum_filter(saddle, 3)) & (saddle > CURVED * saddle.max()) & known)
    # Along edges the second derivative vanishes: at equal angles on both sides of the axis of largest curvature.
    hessian = np.stack([ss[t, s], st[t, s], st[t, s], tt[t, s]], axis=1).reshape(-1, 2, 2)
    size, direction = np.linalg.eigh(hessian)
    spread = np.arctan2(np.sqrt(np.abs(size[:, 0])), np.sqrt(np.abs(size[:, 1])))
    main, other = direction[:, :, 0], direction[:, :, 1]
    cosine, sine = np.cos(spread)[:, None], np.sin(spread)[:, None]
    axes = np.stack([cosine * main + sine * other, cosine * main - sine * other], axis=1)
    return np.column_stack([s, t]).astype(np.float64), axes


def _once(places: Array) -> Array:
    """Drop places within one sample of an earlier one."""
    kept: list[Array] = []
    for place in places:
        if all(np.abs(place - other).max() > 1.0 for other in kept):
            kept.append(place)
    return np.array(kept).reshape(-1, 2)


OFF = np.iinfo(np.int64).min
"""Number of a place that is not a corner of the board."""


def _numbered(places: Array) -> tuple[NDArray[np.int64], Array]:
    """Assign numbers to places from neighbour to neighbour, from the middle outwards; `OFF` for places off the grid."""
    numbers, steps = np.full((len(places), 2), OFF), np.zeros((len(places), 2, 2))
    seed = int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))
    away = places - places[seed]
    order = np.argsort(np.linalg.norm(away, axis=1))[1:]
    one = away[order[0]]
    across = [i for i in order if abs(one[0] * away[i][1] - one[1] * away[i][0]) > 0.5 * one @ one]
    if not across:
        return numbers, steps
    numbers[seed], steps[seed] = 0, np.array([one, away[across[0]]])
    taken, queue = {(0, 0): seed}, [seed]
    while queue:
        here = queue.pop(0)
        for axis, sense in ((0, 1), (0, -1), (1, 1), (1, -1)):
            number = numbers[here] + sense * np.eye(2, dtype=np.int64)[axis]
            step = sense * steps[here, axis]
            far = np.linalg.norm(places - places[here] - step, axis=1)
            there = int(np.argmin(far))
            if tuple(number) in taken or numbers[there, 0] != OFF or far[there] > BESIDE * np.linalg.norm(step):
                continue
            numbers[there], steps[there] = number, steps[here]
            steps[there, axis] = sense * (places[there] - places[here])
            taken[tuple(number)] = there
            queue.append(there)
    return numbers, steps


def _upright(places: Array, numbers: NDArray[np.int64], steps: Array) -> tuple[Array, NDArray[np.int64], Array]:
    """Orient the numbers so that columns run to the right and rows upwards, as far as possible."""
    mean = steps.mean(axis=0)
    if abs(mean[1, 0]) * np.linalg.norm(mean[0]) > abs(mean[0, 0]) * np.linalg.norm(mean[1]):
        numbers, steps, mean = numbers[:, ::-1], steps[:, ::-1], mean[::-1]
    senses = np.array([1 if mean[0, 0] > 0.0 else -1, -1 if mean[1, 1] > 0.0 else 1])
    return places, numbers * senses, steps * senses[:, None]


def _stated(numbers: NDArray[np.int64], columns: int | None, rows: int | None) -> NDArray[np.int64]:
    """Return numbers from 0, rotated by 90° if the stated counts require it."""
    numbers = numbers - numbers.min(axis=0)
    found = tuple(int(n) for n in numbers.max(axis=0) + 1)
    stated = (columns or found[0], rows or found[1])
    if found != stated and found == stated[::-1]:
        numbers, found = np.column_stack([numbers[:, 1], found[0] - 1 - numbers[:, 0]]), stated
    if found != stated or (None not in (columns, rows) and not _ends_are_seen(numbers)):
        raise LfmeshError(
            f"board: {len(numbers)} corners in {found[0]} columns and {found[1]} rows are seen in the middle view, but "
            f"columns = {stated[0]}, rows = {stated[1]}: corners between four squares count, and all except a few of "
            "the outer ones must be in view"
        )
    return np.asarray(numbers)


def _ends_are_seen(numbers: NDArray[np.int64]) -> bool:
    """Tell whether most corners of the first and last columns and rows are visible, so that none is mistaken."""
    last = numbers.max(axis=0)
    return all(
        2 * np.count_nonzero(numbers[:, axis] == end) > last[1 - axis] + 1 for axis in (0, 1) for end in (0, last[axis])
    )


def _followed(views: Array, middle: tuple[int, int], places: Array, steps: Array) -> Array:
    """Return the place of each corner in each view, (v, u, n, 2); NaN if not fully visible."""
    sizes = np.linalg.norm(steps, axis=2)
    axes, reach = steps / sizes[..., None], float(np.median(sizes))
    seen = np.full((*views.shape[:2], len(places), 2), np.nan)
    where = np.full(len(places), middle[0]), np.full(len(places), middle[1])
    seen[middle] = np.where(_whole(views, *where, places, axes, reach)[:, None], places, np.nan)
    from_middle = np.moveaxis(np.indices(views.shape[:2]), 0, -1) - np.array(middle)
    ring = np.abs(from_middle).max(axis=-1)
    for number in range(1, int(ring.max()) + 1):
        start = _expected(seen, places, ring, from_middle, number)
        v, u, corner = np.nonzero((ring == number)[..., None] & np.isfinite(start[..., 0]))
        if not len(v):
            continue
        fitted = fit_corners(views[v, u], start[v, u, corner], axes[corner], reach)
        with np.errstate(invalid="ignore"):
            good = np.isfinite(fitted.place[:, 0]) & (fitted.residual < RESIDUAL)
        good &= _whole(views, v, u, start[v, u, corner], axes[corner], reach)
        seen[v[good], u[good], corner[good]] = fitted.place[good]
    return seen


def _expected(
    seen: Array, middle: Array, ring: NDArray[np.int64], from_middle: NDArray[np.int64], number: int
) -> Array:
    """Predict the corners' places in the views of a ring: the shift from view to view is nearly constant."""
    known = np.isfinite(seen[..., 0])
    v, u, corner = np.nonzero(known & (ring < number)[..., None])
    shift: NDArray[np.floating] = np.zeros((2, 2))
    if number > 1:
        shift = np.linalg.lstsq(from_middle[v, u].astype(np.float64), seen[v, u, corner] - middle[corner])[0]
    expected = middle + (from_middle @ shift)[:, :, None]
    return np.where((ring == number)[..., None, None], expected, np.nan)


def _whole(
    views: Array, v: NDArray[np.int64], u: NDArray[np.int64], start: Array, axes: Array, reach: float
) -> NDArray[np.bool_]:
    """Tell whether the four diagonal samples half a square from each corner are known."""
    whole = np.ones(len(v), bool)
    height, width = views.shape[2:]
    for along, across in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        s, t = np.rint(start + 0.5 * reach * (along * axes[:, 0] + across * axes[:, 1])).astype(np.int64).T
        on = (s >= 0) & (t >= 0) & (s < width) & (t < height)
        whole &= on & np.isfinite(views[v, u, np.clip(t, 0, height - 1), np.clip(s, 0, width - 1)])
    return whole
