"""A lens for two kinds of discs: rays and focal points against formulas in extended precision.

The prescription is that of OpticStudio's sample "Dual zone CD-DVD lens", after U.S. Patent 6,118,594: its inner zone
focuses 780 nm through a disc of 1.2 mm with the order 1 of a phase, and 650 nm through 0.6 mm; the outer zone, without
a phase, focuses 650 nm alone. The indices are those at which its designer's focus is sharp in both zones.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf

Array = NDArray[Any]
LD = np.longdouble

BORDER, OFFSET_RAD = 1.254716223244, -4.185308272828e-7
CURVATURES, TERMS = (0.31117192249100001, 1.0 / 3.213665665249), (-0.01239194561808, -0.0105970662518)
PHASE_RAD = (16.90751898142, -29.47389001431)
THICKNESS, BACK_CURVATURE, BACK_CONIC = 2.4, -0.61704881134470002, -3.55318233467
DISCS = {780.0: (1.4856, 1.222, 1.2, 1.2547), 650.0: (1.489, 1.59779432953, 0.6, 1.73)}
"""By wavelength, nm: index, working distance, thickness of the disc and height of the beam, mm."""


def scene(nm: float) -> lf.Scene:
    """Return the lens and a disc, with the sensor on the back of the disc."""
    index, gap, disc, _ = DISCS[nm]
    front = {
        "radius_mm": 1.0 / CURVATURES[0], "asphere_mm": (TERMS[0],), "thickness_mm": THICKNESS, "index": index,
        "semi_diameter_mm": 2.0, "stop": True,
        "outer_zone": {"border_mm": BORDER, "radius_mm": 1.0 / CURVATURES[1], "asphere_mm": (TERMS[1],)},
        "phase": {
            "kind": "zones",
            "zones": [
                {"border_mm": BORDER, "coefficients_rad": PHASE_RAD, "radius_mm": BORDER},
                {"coefficients_rad": (0.0,), "radius_mm": 2.5, "offset_rad": OFFSET_RAD},
            ],
        },
    }  # fmt: skip
    back = {"radius_mm": 1.0 / BACK_CURVATURE, "conic": BACK_CONIC, "thickness_mm": gap, "semi_diameter_mm": 2.0}
    lens = {"surfaces": [front, back, {"index": index, "semi_diameter_mm": 2.0}]}
    return lf.Scene(
        camera={"lens": lens, "sensor": {"pixels": (400, 400), "pixel_mm": 0.01, "distance_mm": disc}},
        transport={"wavelengths_nm": [nm]},
    )


def front_at(r: Any) -> tuple[Any, Any, Any]:
    """Return sag, slope and derivative of the phase of the front at a distance from the axis."""

    def zone(r: Any, k: int) -> tuple[Any, Any]:
        c, a = LD(CURVATURES[k]), LD(TERMS[k])
        root = np.sqrt(1 - c * c * r * r)
        return c * r * r / (1 + root) + a * r**4, c * r / root + 4 * a * r**3

    if r <= LD(BORDER):
        u = r / LD(BORDER)
        return *zone(r, 0), (2 * LD(PHASE_RAD[0]) * u + 4 * LD(PHASE_RAD[1]) * u**3) / LD(BORDER)
    z, slope = zone(r, 1)
    return z + zone(LD(BORDER), 0)[0] - zone(LD(BORDER), 1)[0], slope, LD(0)


def back_at(r: Any) -> tuple[Any, Any, Any]:
    c, q = LD(BACK_CURVATURE), 1 + LD(BACK_CONIC)
    root = np.sqrt(1 - q * c * c * r * r)
    return c * r * r / (1 + root), c * r / root, LD(0)


def flat_at(r: Any) -> tuple[Any, Any, Any]:
    return 0 * r, 0 * r, LD(0)


def through(p: Array, d: Array, nm: float) -> tuple[Array, Array]:
    """Return point on the sensor and direction of a ray, in extended precision."""
    index, gap, disc, _ = DISCS[nm]
    faces = [(0.0, front_at, 1.0, index), (THICKNESS, back_at, index, 1.0), (THICKNESS + gap, flat_at, 1.0, index)]
    p, d = p.astype(LD), d.astype(LD)
    d = d / np.sqrt(d @ d)
    for vertex, shape, before, behind in faces:
        t = (LD(vertex) - p[2]) / d[2]
        for _ in range(60):
            at = p + t * d
            r = np.hypot(at[0], at[1])
            z, slope, _ = shape(r)
            fall = d[2] - (slope * (at[0] * d[0] + at[1] * d[1]) / r if r else 0)
            t = t - (at[2] - LD(vertex) - z) / fall
        p = p + t * d
        r = np.hypot(p[0], p[1])
        _, slope, steep = shape(r)
        outwards = np.array([p[0], p[1], 0 * r]) / r if r else np.zeros(3, LD)
        normal = np.array([0, 0, 1], LD) - slope * outwards
        normal = normal / np.sqrt(normal @ normal)
        optical = LD(before) * d + LD(nm) * LD(1e-6) / (2 * LD(np.pi)) * steep * outwards
        along = optical - (optical @ normal) * normal
        d = (along + np.sqrt(LD(behind) ** 2 - along @ along) * normal) / LD(behind)
    t = (LD(THICKNESS + gap + disc) - p[2]) / d[2]
    return p + t * d, d


@pytest.mark.parametrize("nm", DISCS)
def test_both_engines_follow_the_formulas_in_both_zones(nm: float) -> None:
    """Skew rays over the aperture, to 1e-11 mm and 1e-11 in direction; none within 0.05 mm of the border."""
    draw = np.random.default_rng(int(nm))
    heights = draw.uniform(0.0, 1.9, 60)
    heights = heights[np.abs(heights - BORDER) > 0.05]
    phi = draw.uniform(0.0, 2.0 * np.pi, len(heights))
    p = np.column_stack([heights * np.cos(phi), heights * np.sin(phi), np.full(len(heights), -2.0)])
    d = np.column_stack([draw.uniform(-0.01, 0.01, (len(heights), 2)), np.ones(len(heights))])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    ends, directions = zip(*(through(*ray, nm) for ray in zip(p, d, strict=True)), strict=True)
    world = lf.build(scene(nm))
    for engine in ("mesh", "sequential"):
        paths = lf.trace(world, p, d, wavelength_nm=nm, split="transmit", engine=engine)
        arrived = np.flatnonzero(paths.status == lf.Status.SENSOR)
        source = paths.source[arrived]
        assert (heights[source] > BORDER).sum() > 8
        assert (heights[source] < BORDER).sum() > 15
        np.testing.assert_allclose(paths.position[arrived], np.array(ends, float)[source], atol=1e-11)
        np.testing.assert_allclose(paths.direction[arrived], np.array(directions, float)[source], atol=1e-11)


@pytest.mark.parametrize("nm", DISCS)
def test_each_zone_focuses_where_its_designer_says(nm: float) -> None:
    """All rays of a beam along the axis meet the disc's back within 1.1 µm of the axis, at sines up to 0.35."""
    height = DISCS[nm][3]
    heights = np.array([h for h in np.linspace(0.05, height, 40) if abs(h - BORDER) > 1e-3])
    p = np.column_stack([heights, 0.0 * heights, np.full(len(heights), -2.0)])
    d = np.tile([0.0, 0.0, 1.0], (len(heights), 1))
    world = lf.build(scene(nm))
    paths = lf.trace(world, p, d, wavelength_nm=nm, split="transmit")
    arrived = paths.status == lf.Status.SENSOR
    assert arrived.sum() == len(heights)
    assert np.hypot(*paths.position[arrived, :2].T).max() < 1.1e-3
    assert np.abs(paths.direction[arrived, 0]).max() > (0.3 if nm == 650.0 else 0.27)


def test_the_outer_zone_is_out_of_focus_for_the_other_disc() -> None:
    """At 780 nm its rays miss the focus of the inner zone by more than 5 µm."""
    for h in np.linspace(1.26, 1.7, 9):
        end, _ = through(np.array([h, 0.0, -2.0]), np.array([0.0, 0.0, 1.0]), 780.0)
        assert abs(float(end[0])) > 5e-3
