"""Aim through lenslets that diffract: the point from which light that is not diffracted would come the same way.

The change of direction is drawn before the lenslet is chosen. With it a ray reaches the opening where one from another
point of the sensor would without. That point lies off the ray's own by the difference of two ways to the lenslet: in
the direction before the change, and in the direction of the opening's centre. So lenslets are chosen as that point sees
them, whatever the change, and next to all rays reach the opening, with the weights that they have without diffraction.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aims.disk import Vector
from lfmesh.transport.aims.lenslet_aim import ArraySeen, Shown, cells_that_show, list_cells, most_listed
from lfmesh.transport.aims.lenslet_faces import path_to_apexes
from lfmesh.transport.tables.tables import LensletAim

Array = NDArray[np.float64]

SEARCH_AFTER_KICK, FURTHEST_SEARCH = 2.0, 5.0
"""Factor on the distance at which lenslets are looked for, as changes of direction widen their views, and that for the
widest ones."""

SHIFT_IN_REACH, GROWTH_IN_REACH = 0.5, 1.25
"""Shift in pitches, where its chief ray meets the array, of the point that needs no change of direction, and growth of
the views, up to which a sample takes the lenslets that were listed for its pixel. The few samples beyond list their
own, which takes far longer."""

MOST_GROWTH = 1.02
"""Growth of the views above which changes of direction are far, so that rays go anywhere, too, and the proof of the aim
leaves them out. Where lenslets are some twenty wavelengths wide, each tenth ray is, and each hundredth one is turned so
far that the opening is seen from nowhere, or in a view that no factor describes."""

WIDE_SHARE_BY_GROWTH, MOST_WIDE_SHARE = 2.5, 0.5
"""Share of rays that go anywhere among samples with a far change of direction, over the growth beyond 1, and the most.

The views miss some thousandths of the light at a growth of 1.1, and some hundredths at 1.5. Rays that go anywhere weigh
some sixty times as much as those to the views, over this share: fewer would gather that light in bright pixels."""


def most_listed_after_kick(aim: LensletAim) -> int:
    """Return the largest number of lenslets that may be listed for a pixel, and behind them for a sample."""
    of_pixel = most_listed(aim, SEARCH_AFTER_KICK * aim.search + SHIFT_IN_REACH)
    return of_pixel + most_listed(aim, FURTHEST_SEARCH * aim.search)


@inlined
def list_cells_of_pixel(apertures: Any, array: ArraySeen, p: Vector, extent: tuple[float, float], near: Array) -> int:
    """List the lenslets by which a pixel's points may see the opening, after changes of direction within reach as well.

    Parameters
    ----------
    apertures : Apertures or None
    array, p, extent, near
        As for `list_cells`.
    """
    lateral, deep = extent
    search = array.aim.search
    if apertures is not None:
        lateral += _shift_in_reach(array, p)
        # A difference in depth widens the views that are listed by this factor, and a little more.
        deep += (GROWTH_IN_REACH - 1.0) * (abs(p[2] - array.aim.apex_z) + deep)
        search = SEARCH_AFTER_KICK * search + SHIFT_IN_REACH
    return list_cells(array, p, (lateral, deep), search, near)


@inlined
def _shift_in_reach(array: ArraySeen, p: Vector) -> float:
    """Return the largest shift, mm, of the point that needs no change of direction, for which lenslets are listed.

    It moves the place where the chief ray meets the array by `SHIFT_IN_REACH` pitches.
    """
    aim = array.aim
    return SHIFT_IN_REACH * array.mla.lenslets.lattice.pitch * (1.0 + aim.pupil_vergence * abs(p[2] - aim.apex_z))


@inlined
def shown_after_kick(
    apertures: Any, array: ArraySeen, near: Array, listed: int, cells: NDArray[np.int64], p: Vector,
    kick: tuple[float, float],
) -> tuple[Shown, float]:  # fmt: skip
    """Return the lenslets that show the opening to a point after a change of direction, and the growth of their views.

    Parameters
    ----------
    apertures : Apertures or None
        None: the direction does not change.
    array : ArraySeen
    near, listed
        From `list_cells_of_pixel`; those of the point are listed behind them where they are out of reach.
    cells : (n,) int64
        As for `cells_that_show`.
    p : (3,) float, mm
        Array frame.
    kick : (2,) float
        See `events.kick.drawn_kick`.
    """
    if apertures is None:
        return cells_that_show(array, near, listed, cells, p, 1.0), 1.0
    growth, seen_from = without_kick(array, p, kick)
    x, y, reach, first = seen_from[0] - p[0], seen_from[1] - p[1], _shift_in_reach(array, p), 0
    if growth > GROWTH_IN_REACH or x * x + y * y > reach * reach:
        first, listed = listed, list_cells_after_kick(array, growth, seen_from, near[listed:])
    return cells_that_show(array, near[first:], listed, cells, seen_from, growth * growth), growth


@kernel
def list_cells_after_kick(array: ArraySeen, growth: float, seen_from: Vector, near: Array) -> int:
    """List the lenslets by which a point of the sensor may see the opening after a change of direction.

    Parameters
    ----------
    array : ArraySeen
    growth, seen_from
        From `without_kick`.
    near : (n, LISTED) float64
        As for `list_cells`.
    """
    if not growth > 0.0:
        return 0
    extent = 0.0, (growth - 1.0) * abs(seen_from[2] - array.aim.apex_z)
    wider = min(max(growth, SEARCH_AFTER_KICK), FURTHEST_SEARCH)
    return list_cells(array, seen_from, extent, wider * array.aim.search, near)


@inlined
def without_kick(array: ArraySeen, p: Vector, kick: tuple[float, float]) -> tuple[float, Vector]:
    """Return by what factor a change of direction widens the views of lenslets, and the point that sees them without.

    The factor is 0 where the point does not see the opening's centre. Otherwise it is the ratio of the changes of slope
    with direction cosine before and after, as the light of all of the opening is moved by the same direction cosines.

    Parameters
    ----------
    array : ArraySeen
    p : (3,) float, mm
        Array frame.
    kick : (2,) float
        See `events.kick.drawn_kick`.
    """
    aim, (air, plate, _) = array.aim, path_to_apexes(array.mla, p[2])
    over, kappa = 1.0 / abs(p[2] - aim.apex_z), aim.pupil_vergence
    # The slope of the chief ray.
    sx, sy = kappa * over * (aim.pupil_x - p[0]) / (kappa + over), kappa * over * (aim.pupil_y - p[1]) / (kappa + over)
    after2 = 1.0 / (1.0 + sx * sx + sy * sy)
    scale = np.sqrt(after2)
    cx, cy = sx * scale, sy * scale
    bx, by = cx - kick[0], cy - kick[1]
    before2 = 1.0 - bx * bx - by * by
    if not before2 > 0.0:
        return 0.0, p
    across, before = _shift(cx, cy, air, plate, array.glass), _shift(bx, by, air, plate, array.glass)
    ratio = after2 / before2
    growth = (1.0 + kick[0] * kick[0] + kick[1] * kick[1]) * max(1.0, ratio * np.sqrt(ratio))
    lever = array.mla.apertures.lever
    return growth, (p[0] + lever * (bx * before - cx * across), p[1] + lever * (by * before - cy * across), p[2])


@inlined
def wide_share_after_kick(growth: float) -> float:
    """Return the share of rays that go anywhere among samples with a change of direction; 0 unless that is far.

    After a far one light comes from elsewhere, too: see `MOST_GROWTH`.

    Parameters
    ----------
    growth : float
        From `without_kick`.
    """
    if 0.0 < growth <= MOST_GROWTH:
        return 0.0
    return min(WIDE_SHARE_BY_GROWTH * (growth - 1.0), MOST_WIDE_SHARE) if growth > 0.0 else MOST_WIDE_SHARE


@inlined
def _shift(cx: float, cy: float, air: float, plate: float, glass: float) -> float:
    """Return the lateral shift over air and glass, mm, of a ray with the given direction cosines, over these."""
    square = cx * cx + cy * cy
    return air / np.sqrt(1.0 - square) + plate / np.sqrt(glass * glass - square)
