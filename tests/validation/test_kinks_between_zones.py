"""What does not follow a kink between zones says so, and what it takes; wavefronts and point spreads across one."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import lfmesh as lf
from lfmesh.accuracy.analytic import own_error
from lfmesh.scene import solved
from lfmesh.view.rays.exact_ghosts import refusal

NM, INDEX, DISTANCE_MM = 550.0, 1.5, 2000.0
RADIUS, CONIC, BACK, THICKNESS, SEMI, BORDER = 20.0, -0.5, -200.0, 3.0, 2.0, 1.0


def scene(change: float | None = 0.2, phase: dict[str, Any] | None = None) -> lf.Scene:
    """Return a lens whose outer zone has a radius longer by a fraction, or none for None."""
    front = {"radius_mm": RADIUS, "thickness_mm": THICKNESS, "index": INDEX, "semi_diameter_mm": SEMI, "stop": True,
             "conic": CONIC}  # fmt: skip
    if change is not None:
        front |= {"outer_zone": {"border_mm": BORDER, "radius_mm": RADIUS * (1.0 + change), "conic": CONIC}}
    if phase is not None:
        front |= {"phase": phase}
    camera: dict[str, Any] = {
        "focus_mm": DISTANCE_MM, "lens": {"surfaces": [front, {"semi_diameter_mm": 2.2, "radius_mm": BACK}]},
        "sensor": {"pixels": [41, 41], "pixel_mm": 0.002},
    }  # fmt: skip
    return lf.Scene(camera=camera, transport={"wavelengths_nm": [NM]})


def steps(offset_rad: float) -> dict[str, Any]:
    """Return a phase with a step of a zone's constant phase."""
    inner = {"border_mm": BORDER, "coefficients_rad": [0.0], "radius_mm": 1.0}
    return {"kind": "zones", "zones": [inner, inner | {"border_mm": None, "offset_rad": offset_rad}]}


def sheet(given: lf.Scene) -> object:
    return lf.analyse(given, across=8)


def ghosts(given: lf.Scene) -> object:
    why = refusal(lf.build(given, aimed=False), [[0.0, 0.0, -DISTANCE_MM]])
    if why is not None:
        raise lf.LfmeshError(why)
    return None


def optimiser(given: lf.Scene) -> object:
    variable = {"path": "camera.lens.surfaces[0].radius_mm", "range": [15.0, 25.0]}
    return lf.optimise(given, [variable], [{"metric": "spot_rms_mm", "target": 0.0}])


def accuracy(given: lf.Scene) -> object:
    return own_error(given, NM, [[0.0, 0.0, -5.0]], [[0.0, 0.0, 1.0]])


@pytest.mark.parametrize("use", [sheet, ghosts, optimiser, accuracy])
def test_an_outer_zone_is_named_with_what_is_valid(use: Callable[[lf.Scene], object]) -> None:
    with pytest.raises(
        lf.LfmeshError, match=r"surfaces\[0\]\.outer_zone: .*one formula only.*omit outer_zone"
    ) as error:
        use(scene())
    assert "border_mm = 1" in str(error.value)
    assert "revolution" not in str(error.value)


def zone_sag(r: float, change: float) -> tuple[float, float]:
    """Return sag and slope of the front."""

    def conic(r: float, radius: float) -> tuple[float, float]:
        root = np.sqrt(1.0 - (1.0 + CONIC) * (r / radius) ** 2)
        return r * r / radius / (1.0 + root), r / radius / root

    if r <= BORDER:
        return conic(r, RADIUS)
    outer = RADIUS * (1.0 + change)
    sag, slope = conic(r, outer)
    return sag + conic(BORDER, RADIUS)[0] - conic(BORDER, outer)[0], slope


def bent(d: np.ndarray, slope: float, before: float, behind: float) -> np.ndarray:
    """Return a direction (r, z) behind a face, by Snell's law."""
    normal = np.array([-slope, 1.0]) / np.hypot(slope, 1.0)
    along = before * (d - (d @ normal) * normal)
    return (along + np.sqrt(behind**2 - along @ along) * normal) / behind


def path_waves(r: float, change: float, image_z: float, sphere_mm: float) -> float:
    """Return the optical path from the object through a radius of the front to a sphere about the image, in waves."""
    z, slope = zone_sag(r, change)
    start, p = np.array([0.0, -DISTANCE_MM]), np.array([r, z])
    way = np.linalg.norm(p - start)
    d = bent((p - start) / way, slope, 1.0, INDEX)

    def height(t: float) -> float:
        at = p + t * d
        return float(at[1] - THICKNESS - at[0] ** 2 / BACK / (1.0 + np.sqrt(1.0 - (at[0] / BACK) ** 2)))

    t = float(brentq(height, 0.0, 10.0, xtol=1e-14, rtol=1e-14))
    q = p + t * d
    d = bent(d, q[0] / BACK / np.sqrt(1.0 - (q[0] / BACK) ** 2), INDEX, 1.0)
    away = q - [0.0, image_z]
    b = float(away @ d)
    s = -b - np.sqrt(b * b - float(away @ away) + sphere_mm**2)
    return float((way + INDEX * t + s) / (NM * 1e-6))


@pytest.mark.parametrize("change", [0.005, -0.005])
def test_wavefront_and_point_spread_across_a_kink_are_those_of_the_rays(change: float) -> None:
    """The path to a billionth of the distance; Strehl's ratio to 0.3 %, as the polynomials miss 0.005 waves."""
    given = scene(change)
    image_z = THICKNESS + (solved(given).camera.sensor.distance_mm or 0.0)
    found = lf.wavefront(given, object_mm=DISTANCE_MM, image_z_mm=image_z, across=16)
    chief = path_waves(0.0, change, image_z, found.radius_mm)
    wanted = [chief - path_waves(SEMI * float(r), change, image_z, found.radius_mm) for r in np.hypot(*found.pupil.T)]
    np.testing.assert_allclose(found.opd_waves, wanted, rtol=0.0, atol=2e-5)
    radii = SEMI * np.sqrt((np.arange(400) + 0.5) / 400)
    waves = np.array([path_waves(float(r), change, image_z, found.radius_mm) for r in radii])
    strehl = abs(np.exp(2j * np.pi * waves).mean()) ** 2
    spread = lf.point_spread(given, [0.0, 0.0, -DISTANCE_MM])
    assert 0.001 < spread.misfit_waves < 0.01
    assert spread.strehl == pytest.approx(strehl, rel=3e-3)
    assert strehl < 0.8


@pytest.mark.parametrize(("given", "key"), [(scene(0.05), r"outer_zone"), (scene(None, steps(1.0)), r"phase\.zones")])
def test_a_point_spread_that_polynomials_miss_is_refused_by_the_zone(given: lf.Scene, key: str) -> None:
    with pytest.raises(lf.LfmeshError, match=rf"kink or step of camera\.lens\.surfaces\[0\]\.{key} at 1 mm.*residual"):
        lf.point_spread(given, [0.0, 0.0, -DISTANCE_MM])
