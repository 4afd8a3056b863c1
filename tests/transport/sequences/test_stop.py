"""Diffraction at the stop: edges against the transfer function of a round pupil, and the methods against each other."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.scene import Camera, Lens, Scene, Sensor, Surface, Transport

NM, PIXEL_MM, PIXELS = 550.0, 0.004, 24
LEVEL = 1e-5
"""Of each test, at which it fails by chance."""

Array = np.ndarray[Any, Any]

LENSES = {
    "thin lens": (Surface(paraxial=True, focal_length_mm=50.0, semi_diameter_mm=1.25, stop=True),),
    "far before the lens": (
        Surface(stop=True, semi_diameter_mm=1.25, thickness_mm=30.0),
        Surface(paraxial=True, focal_length_mm=50.0, semi_diameter_mm=5.0),
    ),
    "far behind the lens": (
        Surface(paraxial=True, focal_length_mm=50.0, semi_diameter_mm=5.0, thickness_mm=25.0),
        Surface(stop=True, semi_diameter_mm=0.6),
    ),
    "between lenses of glass": (
        Surface(radius_mm=60.0, thickness_mm=3.0, index=1.6, semi_diameter_mm=5.0),
        Surface(radius_mm=-400.0, thickness_mm=8.0, semi_diameter_mm=5.0),
        Surface(stop=True, semi_diameter_mm=1.2, thickness_mm=6.0),
        Surface(radius_mm=90.0, thickness_mm=3.0, index=1.7, semi_diameter_mm=5.0),
        Surface(radius_mm=400.0, semi_diameter_mm=5.0),
    ),
    "in glass": (
        Surface(radius_mm=30.0, thickness_mm=5.0, index=1.6, semi_diameter_mm=5.0),
        Surface(stop=True, semi_diameter_mm=1.2, thickness_mm=5.0, index=1.6),
        Surface(radius_mm=-300.0, semi_diameter_mm=5.0),
    ),
    "on a surface": (
        Surface(radius_mm=30.0, thickness_mm=3.0, index=1.6, semi_diameter_mm=1.3, stop=True),
        Surface(radius_mm=-300.0, semi_diameter_mm=5.0),
    ),
}
"""Lenses of some f/20, with stops in air, in glass and on a surface, their pupils magnified or not."""


def edge(name: str, **transport: Any) -> Scene:
    """A bright half-plane whose edge falls between the middle columns of a row of pixels."""
    at_mm, wide_mm = 1e5, 8e3
    return Scene(
        camera=Camera(
            lens=Lens(surfaces=LENSES[name]), sensor=Sensor(pixels=(PIXELS, 1), pixel_mm=PIXEL_MM), focus_mm=at_mm
        ),
        targets=[
            {
                "shape": {"kind": "plane", "width_mm": wide_mm, "height_mm": wide_mm},
                "position_mm": (0.5 * wide_mm, 0.0, -at_mm),
                "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
            }
        ],
        transport=Transport(
            **{
                "diffraction": "stop", "split": "transmit", "wavelengths_nm": (NM,), "threads": 1, "replicates": 32,
                "samples": 25_600, **transport,
            }
        ),
    )  # fmt: skip


def edge_of_round_pupil(f_number: float, nm: float = NM) -> Array:
    """Light on pixels across the image of an edge, (PIXELS,), relative to a bright plane; dark first.

    ½ + ∫ MTF(ν) sinc(ν p) sin(2π ν x) / (π ν) dν, up to the cut-off 1 / λN.
    """
    cut_off = 1.0 / (nm * 1e-6 * f_number)
    part = (np.arange(20_000) + 0.5) / 20_000
    nu = part * cut_off
    transfer = 2.0 / np.pi * (np.arccos(part) - part * np.sqrt(1.0 - part**2)) * np.sinc(nu * PIXEL_MM)
    x = (np.arange(PIXELS) - 0.5 * (PIXELS - 1)) * PIXEL_MM
    return 0.5 + (transfer / (np.pi * part) * np.sin(2.0 * np.pi * np.outer(x, nu))).mean(axis=1)


def worst(mean: Array, error: Array, truth: Array) -> float:
    """Return the largest difference of pixels from the truth up to a factor, in standard errors."""
    mean, error = mean.ravel(), error.ravel()
    mean, error = (mean, error) if mean[0] < mean[-1] else (mean[::-1], error[::-1])
    scale = (mean * truth / error**2).sum() / (truth**2 / error**2).sum()
    return float((np.abs(mean - scale * truth) / error).max())


def passes(t: float, number: int, replicates: int) -> bool:
    """Tell whether the largest of a number of t-values is one by chance."""
    return bool(2.0 * stats.t.sf(t, replicates - 1) * number > LEVEL)


@pytest.mark.parametrize("name", LENSES)
def test_edges_are_blurred_as_by_a_round_pupil(name: str) -> None:
    """By λN with the image side's f-number, wherever the stop is: étendue is kept between."""
    scene = edge(name)
    image, number = lf.render(scene), lf.first_order(scene).working_f_number
    assert 15.0 < number < 25.0
    assert passes(worst(image.mean, image.error, edge_of_round_pupil(number)), PIXELS, image.replicates)
    for other in (0.85, 1.15):
        assert not passes(worst(image.mean, image.error, edge_of_round_pupil(other * number)), PIXELS, image.replicates)
    assert abs(image.ledger.imbalance) < 1e-12


def test_each_wavelength_is_blurred_by_its_own_width() -> None:
    scene = edge("between lenses of glass", wavelengths_nm=(450.0, 550.0, 700.0))
    image, number = lf.render(scene), lf.first_order(scene).working_f_number
    for channel, nm in enumerate((450.0, 550.0, 700.0)):
        mean, error = (each[..., channel] for each in (image.mean, image.error))
        assert passes(worst(mean, error, edge_of_round_pupil(number, nm)), PIXELS, image.replicates)


def patch(name: str, **transport: Any) -> Scene:
    """A bright square a little larger than the picture of the few pixels that look at it."""
    scene = edge(name, replicates=16, **transport)
    return scene.changed(
        {
            "camera.sensor.pixels": (6, 6),
            "targets": [
                {
                    "shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 40.0},
                    "position_mm": (5.0, 3.0, -1e5),
                    "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
                }
            ],
        }
    )


@pytest.mark.parametrize("name", LENSES)
def test_forward_equals_adjoint_behind_a_stop_that_diffracts(name: str) -> None:
    adjoint, forward = (lf.render(patch(name, samples=n, method=m)) for n, m in ((1600, "adjoint"), (8000, "forward")))
    error = np.hypot(adjoint.error, forward.error)
    assert passes(float((np.abs(adjoint.mean - forward.mean) / error).max()), 36, 16)
    for image in (adjoint, forward):
        assert abs(image.ledger.imbalance) < 1e-12


def vignetted(rim: str = "before", **transport: Any) -> Scene:
    """Pixels whose view of a stop of f/400 the rim of a lens before or behind it cuts."""
    lens = {"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 0.15}
    stop = {"stop": True, "semi_diameter_mm": 0.06}
    first, second = (lens, stop) if rim == "before" else (stop, lens)
    return Scene(
        camera=Camera(
            lens=Lens(surfaces=(Surface(**first, thickness_mm=25.0), Surface(**second))),
            sensor=Sensor(pixels=(6, 1), pixel_mm=0.1),
            focus_mm=1000.0,
        ),
        targets=[
            {
                "shape": {"kind": "plane", "width_mm": 16.0, "height_mm": 3.0},
                "position_mm": (0.0, 0.0, -1000.0),
                "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
            }
        ],
        transport=Transport(
            **{"diffraction": "stop", "split": "transmit", "wavelengths_nm": (NM,), "threads": 1, **transport}
        ),
    )


@pytest.mark.parametrize("rim", ["before", "behind"])
def test_light_that_turns_past_a_rim_at_the_stop_is_in_the_picture(rim: str) -> None:
    """Pixels aim at all of the stop, not at the part of it that is open to rays that do not turn."""
    runs = ((204_800, "adjoint"), (204_800, "forward"))
    adjoint, forward = (lf.render(vignetted(rim, samples=n, method=m, replicates=16)) for n, m in runs)
    error = np.hypot(adjoint.error, forward.error)
    assert passes(float((np.abs(adjoint.mean - forward.mean) / error).max()), 6, 16)
    # The box of the lens holds the stop: else light that misses the lens unless it turns is lost, 8 % of all.
    whole = float(np.sqrt((error**2).sum()))
    assert whole < 0.015 * adjoint.mean.sum()
    assert abs(adjoint.mean.sum() - forward.mean.sum()) < 4.5 * whole
    # An aim at the open part of the stop finds some seven tenths of the light there.
    assert error[0, 0, 0] < 0.04 * forward.mean[0, 0, 0]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"transport.split": "both"}, "along the image path only"),
        ({"transport.engine": "mesh"}, "along the image path only"),
        ({"transport.diffraction": "lenslets"}, 'without an array give "stop"'),
    ],
)
def test_what_is_not_followed_is_refused(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(lf.LfmeshError, match=words):
        edge("thin lens").changed(changed)


def test_surfaces_that_are_not_exact_are_refused() -> None:
    with pytest.raises(lf.LfmeshError, match="needs sequential tracing of exact surfaces"):
        lf.render(edge("on a surface", samples=32).changed({"transport.surface": "flat"}))


def test_a_stop_is_not_diffracted_at_before_an_array() -> None:
    mla = {"count": (3, 3), "pitch_mm": 0.1, "radius_mm": 1.0, "index": 1.5, "thickness_mm": 0.1}
    with pytest.raises(lf.LfmeshError, match="worsens pictures behind an array"):
        edge("on a surface").changed({"camera.mla": mla})


def test_warnings_know_the_stop() -> None:
    plain, traced = (edge("thin lens", diffraction=choice) for choice in ("none", "stop"))
    assert any('take transport.diffraction = "stop"' in line for line in lf.first_order(plain).warnings)
    assert not any("Airy disk" in line for line in lf.first_order(traced).warnings)
