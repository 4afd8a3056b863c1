"""Real meridional rays against closed forms, and the warning that follows from them."""

import math

import numpy as np
import pytest

from lfmesh.scene import Lens, Paraxial, Scene, Surface, first_order
from lfmesh.scene.first_order.beam_bounds import followed
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


@pytest.mark.parametrize("guess", [5.0, 8.0, 15.0, 30.0])
def test_the_axial_beam_ends_with_the_first_ray_that_meets_the_edge_of_the_stop(guess: float) -> None:
    """Rays farther out come back into this stop: of 4000 rays the first beyond its edge bounds the beam."""
    lens = Lens(
        surfaces=(
            Surface(radius_mm=800.0, conic=9999.0, thickness_mm=30.0, index=1.5, semi_diameter_mm=7.9),
            Surface(asphere_mm=(2e-4, -3e-6), thickness_mm=40.0, semi_diameter_mm=12.0),
            Surface(semi_diameter_mm=6.0, stop=True),
        )
    )
    fan = [heights_mm(lens, 587.6, math.inf, 0.002 * ray) for ray in range(4000)]
    first = next(ray for ray, heights in enumerate(fan) if abs(heights[2]) > 6.0)
    assert any(abs(heights[2]) < 5.9 for heights in fan[first:])
    found = beam_mm(lens, 587.6, math.inf, guess).found_mm
    assert 0.002 * (first - 1) <= found[0] <= 0.002 * first
    assert found[2] == pytest.approx(6.0, rel=2e-6)


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
    assert beam_mm(ball(), 587.6, math.inf, 9.99).found_mm == pytest.approx(widest, rel=1e-5)
    assert widest[1] > 2.5 * abs(edge_of_stop_mm(ball(), 587.6, math.inf, 9.99)[1][1])


def test_an_aperture_that_clips_inner_rays_only_is_warned_of() -> None:
    front, back = ball().surfaces
    surfaces = (front, back.model_copy(update={"semi_diameter_mm": 1.5}))
    camera = {"focus_mm": math.inf, "lens": Lens(surfaces=surfaces), "sensor": {"pixels": [8, 8], "pixel_mm": 0.01}}
    scene = Scene.model_validate({"schema_version": 1, "camera": camera})
    assert any("3.96 mm wide on surfaces[1]" in warning for warning in first_order(scene).warnings)


def corrector(seed: int, clear_mm: float = 30.0) -> Lens:
    """A lens with a random asphere in front that bends the rays of some zone farther out than all others."""
    draw = np.random.default_rng(seed)
    radius = draw.uniform(5.0, 12.0)
    share, power = draw.uniform(0.1, 0.4), int(draw.integers(2, 9))
    terms = [0.0] * power
    terms[-1] = float(share / (radius ** (2 * power + 1) * (2 * power + 2)))
    front = Surface(radius_mm=draw.uniform(40.0, 90.0), asphere_mm=tuple(terms), thickness_mm=3.0, index=1.5,
                    semi_diameter_mm=radius, stop=True)  # fmt: skip
    back = Surface(radius_mm=-draw.uniform(60.0, 200.0), thickness_mm=25.0, semi_diameter_mm=30.0)
    return Lens(surfaces=(front, back, Surface(radius_mm=-80.0, semi_diameter_mm=clear_mm)))


@pytest.mark.parametrize("seed", range(4))
def test_the_axial_beam_is_as_wide_as_the_outermost_of_three_thousand_rays(seed: int) -> None:
    """Off by what lies between them at most: a parabola's sag over a step, some 1e-6."""
    lens = corrector(seed)
    edge = lens.surfaces[0].semi_diameter_mm or math.nan
    distance = math.inf if seed % 2 else 300.0
    entry, _ = edge_of_stop_mm(lens, 587.6, distance, edge)
    fan = [heights_mm(lens, 587.6, distance, entry * ray / 3000) for ray in range(3001)]
    widest = [max(abs(heights[number]) for heights in fan if len(heights) > number) for number in range(3)]
    assert beam_mm(lens, 587.6, distance, edge).found_mm == pytest.approx(widest, rel=3e-6)


def test_no_ray_of_a_zone_leaves_its_bounds() -> None:
    draw = np.random.default_rng(5)
    for seed in range(8):
        lens, low = corrector(seed), draw.uniform(0.0, 4.0, 40)
        high = low + 10.0 ** draw.uniform(-4.0, 0.0, 40)
        bounds = followed(lens, 587.6, 200.0, low, high).heights_mm
        assert np.isfinite(bounds).mean() > 0.5
        for i in range(40):
            for share in draw.uniform(0.0, 1.0, 5):
                heights = heights_mm(lens, 587.6, 200.0, float(low[i] + share * (high[i] - low[i])))
                for (least, most), height in zip(bounds[:, :, i], heights, strict=True):
                    assert not height < least - 1e-12
                    assert not height > most + 1e-12


def test_an_aperture_that_clips_a_zone_of_less_than_a_hundredth_is_warned_of() -> None:
    """Of a zone between those of a grid of 33 rays, whose parabola through three falls short by 3.5e-4."""
    lens = corrector(6)
    fan = [
        heights_mm(lens, 587.6, math.inf, (lens.surfaces[0].semi_diameter_mm or 0.0) * k / 4000) for k in range(4001)
    ]
    heights = [each[2] for each in fan if len(each) == 3]
    clear = max(heights) * (1.0 - 1e-5)
    assert 0 < sum(height > clear for height in heights) < 40
    for wide, warned in ((clear, True), (max(heights) * (1.0 + 1e-5), False)):
        camera = {"focus_mm": math.inf, "lens": corrector(6, wide), "sensor": {"pixels": [8, 8], "pixel_mm": 0.01}}
        scene = Scene.model_validate({"schema_version": 1, "camera": camera})
        assert any("surfaces[2]" in warning for warning in first_order(scene).warnings) is warned
