"""Fluxes of slabs that scatter many times against printed tables.

H. C. van de Hulst, Multiple Light Scattering (1980): volume 1, table 12, pages 258 and 259 (isotropic), and volume 2,
table 35, page 419 (Henyey and Greenstein), as the tests of the radiative transfer program flick quote them by page; the
case of g = 0.75 is the one that Wang, Jacques & Zheng (Comput. Methods Programs Biomed. 47, 131, 1995) take from
table 35, and the half-space of index 1.5 theirs from R. G. Giovanelli, Opt. Acta 2, 153 (1955).
"""

import numpy as np
import pytest

import lfmesh as lf
from tests.cameras import camera_without_array
from tests.validation.test_media import slab_radiance

SLABS = [
    # albedo, optical depth, g, flux reflected, flux transmitted with what is not scattered; None: not quoted
    (1.0, 1.0, 0.0, 0.34133, 0.65867),
    (1.0, 1.0, 0.5, None, 0.82389),
    (0.9, 1.0, 0.5, None, 0.73909),
    (0.9, 2.0, 0.75, 0.09739, 0.66096),
]
GIOVANELLI = 0.2600
AWAY_MM = 4e3
"""Distance from the camera at which rays meet a slab: what comes back hardly ever meets the lens."""


def fluxes(rays: int, thickness: float, scene: lf.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares of a beam along −z that leave a slab upwards and downwards, and their standard errors.

    The beam is divided into a hundred parts, whose spread gives the errors.
    """
    origins = np.tile([AWAY_MM, 0.0, -100.0 + 0.5 * thickness + 5.0], (rays, 1))
    paths = lf.trace(lf.build(scene), origins, np.tile([0.0, 0.0, -1.0], (rays, 1)))
    up = paths.direction[:, 2] > 0.0
    out = paths.status != lf.Status.DEPTH
    shares = np.array(
        [np.bincount(paths.source[way & out] % 100, paths.weight[way & out], 100) * 100.0 / rays for way in (up, ~up)]
    )
    return shares.mean(axis=1), shares.std(axis=1, ddof=1) / 10.0


@pytest.mark.parametrize(("albedo", "depth", "g", "reflected", "transmitted"), SLABS)
def test_adding_and_doubling_gives_the_printed_fluxes(
    albedo: float, depth: float, g: float, reflected: float | None, transmitted: float
) -> None:
    """The independent solution that images of slabs are held against is right to the last printed digit but one."""
    found = slab_radiance(albedo, depth, g, 0.5)
    assert found[1][1] + np.exp(-depth) == pytest.approx(transmitted, abs=2e-5)
    if reflected is not None:
        assert found[0][1] == pytest.approx(reflected, abs=2e-5)


@pytest.mark.parametrize(("albedo", "depth", "g", "reflected", "transmitted"), SLABS)
def test_slabs_reflect_and_transmit_the_printed_fluxes(
    albedo: float, depth: float, g: float, reflected: float | None, transmitted: float
) -> None:
    """Six z-tests at 3 sigma, sigma below 0.5 %."""
    slab = {"bounds": {"kind": "box", "size_mm": [2e4, 2e3, 2.0]}, "position_mm": [0.0, 0.0, -100.0],
            "scattering_per_mm": 0.5 * albedo * depth, "absorption_per_mm": 0.5 * (1.0 - albedo) * depth,
            "phase": {"kind": "henyey_greenstein", "g": g}}  # fmt: skip
    scene = lf.Scene(camera=camera_without_array(), media=[slab], transport={"max_events": 1000})  # type: ignore[arg-type, list-item]
    found, sigma = fluxes(60_000 if g < 0.6 else 250_000, 2.0, scene)
    for value, error, expected in zip(found, sigma, (reflected, transmitted), strict=True):
        if expected is not None:
            assert error < 0.005 * expected
            assert abs(value - expected) < 3.0 * error + 5e-6, (value, error, expected)


def test_a_half_space_of_index_reflects_what_giovanelli_printed() -> None:
    """Isotropic, of albedo 0.9 and index 1.5 under air, with what its face reflects: 3 sigma, sigma below 0.5 %."""
    glass = {"name": "half", "refractor": {"box_mm": [2e4, 4e3, 60.0], "index": 1.5}, "position_mm": [0.0, 0.0, -100.0]}
    fog = {"inside": "half", "scattering_per_mm": 0.9, "absorption_per_mm": 0.1}
    scene = lf.Scene(camera=camera_without_array(), media=[fog], targets=[glass], transport={"max_events": 1000})  # type: ignore[arg-type, list-item]
    found, sigma = fluxes(60_000, 60.0, scene)
    assert sigma[0] < 0.005 * GIOVANELLI
    assert abs(found[0] - GIOVANELLI) < 3.0 * sigma[0] + 5e-5, (found, sigma)
