"""Real meridional rays against closed forms, and the warning that follows from them."""

import math

import pytest

from lfmesh.scene import Lens, Paraxial, Scene, Surface, first_order
from lfmesh.scene.first_order.meridional import beam_mm, edge_of_stop_mm, heights_mm


def ball(index: float = 1.5, radius: float = 10.0) -> Lens:
    """A sphere of glass, whose rays Snell's law gives in two lines."""
    return Lens(
        surfaces=(
            Surface(radius_mm=radius, thickness_mm=2 * radius, index=index, semi_diameter_mm=9.99, stop=True),
            Surface(radius_mm=-radius, semi_diameter_mm=9.99),
        )
    )


@pytest.mark.parametrize("height", [0.1, 3.0, 7.0, 9.5])
def test_a_ray_through_a_ball_turns_by_what_snell_says(height: float) -> None:
    first, second = heights_mm(ball(), 587.6, math.inf, height)
    outside = math.asin(height / 10.0)
    inside = math.asin(height / 15.0)
    assert first == pytest.approx(height, rel=1e-12)
    # The chord ends where the central angle from the first point is 180 degrees less twice the inner angle.
    assert second == pytest.approx(-10.0 * math.sin(math.pi - outside - (math.pi - 2 * inside)) * -1.0, rel=1e-9)


def test_a_parabolic_plate_sends_parallel_light_by_snell() -> None:
    """From glass into air: the height on a plane behind, from the slope of the sag."""
    lens = Lens(
        surfaces=(
            Surface(thickness_mm=5.0, index=1.5, semi_diameter_mm=8.0, stop=True),
            Surface(radius_mm=-20.0, conic=-1.0, thickness_mm=10.0, semi_diameter_mm=8.0),
            Surface(semi_diameter_mm=8.0),
        )
    )
    y = 4.0
    *_, met, last = heights_mm(lens, 587.6, math.inf, y)
    tilt = math.atan(y / 20.0)
    turn = math.asin(1.5 * math.sin(tilt)) - tilt
    assert met == pytest.approx(y, rel=1e-12)
    assert last == pytest.approx(y - (10.0 + y * y / 40.0) * math.tan(turn), rel=1e-9)


def test_the_ray_at_the_edge_of_the_stop_meets_it(scene: Scene) -> None:
    lens = scene.camera.lens
    _, heights = edge_of_stop_mm(lens, 587.6, 400.0, 6.0)
    assert heights[0] == pytest.approx(6.0, rel=1e-12)
    assert heights == pytest.approx(heights_mm(lens, 587.6, 400.0, 6.0), rel=1e-9)


@pytest.mark.parametrize("guess", [0.5, 4.0, 9.0])
def test_the_ray_at_the_edge_of_a_stop_behind_is_found_from_any_guess(guess: float) -> None:
    """A ball turns rays the more the farther out they are."""
    front, back = (surface.model_copy(update={"stop": False}) for surface in ball().surfaces)
    edge = back.model_copy(update={"stop": True, "semi_diameter_mm": 1.0})
    _, heights = edge_of_stop_mm(Lens(surfaces=(front, edge)), 587.6, math.inf, guess)
    outside, inside = math.asin(heights[0] / 10.0), math.asin(heights[0] / 15.0)
    assert abs(10.0 * math.sin(2 * inside - outside)) == pytest.approx(1.0, rel=1e-12)


def test_a_ray_that_no_surface_meets_ends_there() -> None:
    assert heights_mm(ball(), 587.6, math.inf, 10.5) == []


@pytest.mark.parametrize(("excess", "warned"), [(0.998, True), (1.002, False)])
def test_the_warning_of_apertures_is_that_of_real_rays(scene: Scene, excess: float, warned: bool) -> None:
    """Spherical aberration and sags make the real beam wider on the back than the paraxial one, by more than that."""
    big = scene.changed({"camera.lens.surfaces[0].semi_diameter_mm": 9.5})
    real = edge_of_stop_mm(big.camera.lens, 587.6, 400.0, 9.5)[1][2]
    tight = big.changed({"camera.lens.surfaces[2].semi_diameter_mm": real * excess})
    assert any("clear aperture" in warning for warning in first_order(tight).warnings) is warned
    paraxial = Paraxial.of(big.camera.lens, 587.6)
    assert paraxial.heights_mm(paraxial.marginal_ray(400.0, 9.5))[2] < 0.998 * real


def test_the_axial_beam_is_as_wide_as_its_outermost_ray_of_any_zone() -> None:
    """On the back of a ball inner rays lie 2.9 times as far from the axis as those of the rim."""
    fan = [heights_mm(ball(), 587.6, math.inf, 9.99 * ray / 800) for ray in range(801)]
    widest = [max(abs(heights[number]) for heights in fan) for number in range(2)]
    assert beam_mm(ball(), 587.6, math.inf, 9.99) == pytest.approx(widest, rel=1e-3)
    assert widest[1] > 2.5 * abs(edge_of_stop_mm(ball(), 587.6, math.inf, 9.99)[1][1])


def test_an_aperture_that_clips_inner_rays_only_is_warned_of() -> None:
    front, back = ball().surfaces
    surfaces = (front, back.model_copy(update={"semi_diameter_mm": 1.5}))
    camera = {"focus_mm": math.inf, "lens": Lens(surfaces=surfaces), "sensor": {"pixels": [8, 8], "pixel_mm": 0.01}}
    scene = Scene.model_validate({"schema_version": 1, "camera": camera})
    assert any("3.96 mm wide on surfaces[1]" in warning for warning in first_order(scene).warnings)
