"""How spheres and cylinders stand to each other, against points of their surfaces."""

import numpy as np
import pytest

from lfmesh.geometry.frame import frame
from lfmesh.geometry.objects.round_body import RoundBody
from lfmesh.geometry.objects.round_pairs import Pair, common_place, pair_of
from lfmesh.scene import Cylinder, Sphere

WHOLE = np.array([[0.0, 0.0], [1.0, 1.0]])
NEAR = 1e-5


def body(shape: Sphere | Cylinder, at: object = (0.0, 0.0, 0.0), turned: object = (0.0, 0.0, 0.0)) -> RoundBody:
    return RoundBody(shape, frame(turned, at), WHOLE)


def ball(radius: float, *at: float) -> RoundBody:
    return body(Sphere(radius_mm=radius), at)


def rod(radius: float, height: float, *at: float, turned: object = (0.0, 0.0, 0.0)) -> RoundBody:
    return body(Cylinder(radius_mm=radius, height_mm=height), at, turned)


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (ball(2.0, 0, 0, 0), ball(3.0, 5.0001, 0, 0), Pair.APART),
        (ball(2.0, 0, 0, 0), ball(3.0, 5.0, 0, 0), Pair.APART),
        (ball(2.0, 0, 0, 0), ball(3.0, 4.9999, 0, 0), Pair.CUT),
        (ball(2.0, 0, 0, 0), ball(3.0, 0.9999, 0, 0), Pair.FIRST_INSIDE),
        (ball(3.0, 0, 0, 0), ball(2.0, 1.0, 0, 0), Pair.SECOND_INSIDE),
        (ball(3.0, 0, 0, 0), ball(2.0, 1.0001, 0, 0), Pair.CUT),
        # On the floor of a rod, at its wall, in its corner.
        (ball(1.0, 0, 0, -4.0), rod(3.0, 10.0, 0, 0, 0), Pair.FIRST_INSIDE),
        (ball(1.0, 0, 0, -4.001), rod(3.0, 10.0, 0, 0, 0), Pair.CUT),
        (ball(1.0, 2.0, 0, -4.0), rod(3.0, 10.0, 0, 0, 0), Pair.FIRST_INSIDE),
        (ball(1.0, 4.001, 0, 0), rod(3.0, 10.0, 0, 0, 0), Pair.APART),
        (ball(1.0, 3.999, 0, 0), rod(3.0, 10.0, 0, 0, 0), Pair.CUT),
        (ball(1.0, 3.0 + 0.7072, 0, 5.0 + 0.7072), rod(3.0, 10.0, 0, 0, 0), Pair.APART),
        (ball(1.0, 3.0 + 0.7070, 0, 5.0 + 0.7070), rod(3.0, 10.0, 0, 0, 0), Pair.CUT),
        (rod(3.0, 8.0, 0, 0, 0), ball(5.0, 0, 0, 0), Pair.FIRST_INSIDE),
        (rod(3.0, 8.001, 0, 0, 0), ball(5.0, 0, 0, 0), Pair.CUT),
        # Crossed rods, whose walls pass each other in a point, and ends on each other.
        (rod(1.0, 9.0, 0, 0, 0), rod(2.0, 9.0, 3.001, 0, 0, turned=(90, 0, 0)), Pair.APART),
        (rod(1.0, 9.0, 0, 0, 0), rod(2.0, 9.0, 2.999, 0, 0, turned=(90, 0, 0)), Pair.CUT),
        (rod(1.0, 9.0, 0, 0, 0), rod(2.0, 4.0, 0, 0, 6.5), Pair.APART),
        (rod(1.0, 9.0, 0, 0, 0), rod(2.0, 4.0, 0, 0, 6.49), Pair.CUT),
        (rod(1.0, 3.0, 0, 0, 0), rod(2.0, 4.0, 0, 0, 0, turned=(10, 0, 0)), Pair.FIRST_INSIDE),
    ],
)  # fmt: skip
def test_contact_is_exact_to_the_depth_that_counts_as_touching(
    one: RoundBody, other: RoundBody, expected: Pair
) -> None:
    swapped = {Pair.FIRST_INSIDE: Pair.SECOND_INSIDE, Pair.SECOND_INSIDE: Pair.FIRST_INSIDE}
    assert pair_of(one, other, NEAR) is expected
    assert pair_of(other, one, NEAR) is swapped.get(expected, expected)


def test_random_pairs_stand_as_points_of_one_say_of_the_other() -> None:
    """Against random points of both bodies; pairs that these do not decide are left out."""
    draw = np.random.default_rng(2)
    decided = 0
    for _ in range(60):
        pair = [
            ball(draw.uniform(0.5, 3.0), *draw.uniform(-2.5, 2.5, 3))
            if draw.random() < 0.4
            else rod(*draw.uniform(0.5, 3.0, 2), *draw.uniform(-2.5, 2.5, 3), turned=draw.uniform(-180, 180, 3))
            for _ in range(2)
        ]
        points = draw.uniform(-7.0, 7.0, (50_000, 3))
        one, other = (points[each.holds(points)] for each in pair)
        within = other_holds, one_holds = pair[1].holds(one), pair[0].holds(other)
        found = pair_of(*pair, NEAR)
        if other_holds.any() and not other_holds.all() and one_holds.any() and not one_holds.all():
            assert found is Pair.CUT
            decided += 1
        if found is not Pair.CUT:
            shares = [each.mean() for each in within]
            assert shares[0] == (found is Pair.FIRST_INSIDE) or found is Pair.SECOND_INSIDE
            assert shares[1] == (found is Pair.SECOND_INSIDE) or found is Pair.FIRST_INSIDE
            decided += 1
    assert decided > 30


def test_bent_surfaces_that_lie_on_each_other_are_found() -> None:
    assert common_place(ball(2.0, 0, 0, 0), ball(2.0, 0, 0, 1e-6), NEAR) is not None
    assert common_place(ball(2.0, 0, 0, 0), ball(2.0001, 0, 0, 0), NEAR) is None
    assert common_place(rod(2.0, 5.0, 0, 0, 0), rod(2.0, 3.0, 0, 0, 3.0), NEAR) is not None
    assert common_place(rod(2.0, 5.0, 0, 0, 0), rod(2.0, 3.0, 0, 0, 4.0), NEAR) is None
    assert common_place(rod(2.0, 5.0, 0, 0, 0), rod(2.0, 5.0, 0, 0, 0, turned=(0, 1, 0)), NEAR) is None
    assert common_place(rod(2.0, 5.0, 0, 0, 0), ball(2.0, 0, 0, 0), NEAR) is None
