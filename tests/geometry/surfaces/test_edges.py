"""Rings between rims and the surfaces beside them: closed forms, and brute force over many points."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry.lens.lens_shape import lens_shape
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.surfaces.edges import ring_profile, stays_beside
from lfmesh.geometry.surfaces.surface import BICONIC, TOROID, surface
from lfmesh.geometry.surfaces.tessellation import mesh_heights
from tests.cameras import camera_without_array

RADIUS_MM, TERM = 20.0, -1.5 / (12.0 * 20.0 * 12.0**2)
"""A paraboloid with a term in r⁴ that bends it downwards near its rim at 12 mm: z″ = −0.025 / mm there."""

DIP = 0.02
"""Length in mm along which an edge that begins on the rim is inside the surface; 4 mm of edge had 127 samples."""


def sag_of(r: float) -> float:
    return r**2 / (2.0 * RADIUS_MM) + TERM * r**4


def bend_of(r: float) -> float:
    return 1.0 / RADIUS_MM + 12.0 * TERM * r**2


def tangent_height(rim: float, inner: float) -> float:
    """Return z at a radius of the tangent of the meridian at the rim."""
    slope = rim / RADIUS_MM + 4.0 * TERM * rim**3
    return sag_of(rim) - slope * (rim - inner)


def test_a_cone_that_dips_into_a_surface_between_any_samples_is_refused() -> None:
    front = surface(RADIUS_MM, -1.0, (TERM,), semi_diameter=12.0)
    steeper = 0.5 * DIP * abs(bend_of(12.0))
    for turned in (-1.0, 1.0):
        # The flat annulus would cut the front surface: only a cone is left.
        back = surface(np.inf, vertex_z=tangent_height(12.0, 8.0) + turned * steeper * 4.0, semi_diameter=8.0)
        if turned > 0.0:
            np.testing.assert_allclose(ring_profile(front, 12.0, back, 8.0)[:, 0], [12.0, 8.0])
        else:
            with pytest.raises(lf.SceneError, match="rims of two neighbouring surfaces cross"):
                ring_profile(front, 12.0, back, 8.0)


def shifted(thickness_mm: float) -> lf.Scene:
    """Return a lens whose flat back face is shifted along the axis."""
    lens = {
        "surfaces": [
            {"radius_mm": RADIUS_MM, "conic": -1.0, "asphere_mm": [TERM], "thickness_mm": thickness_mm + 1.0,
             "index": 1.5, "semi_diameter_mm": 12.0, "stop": True},
            {"semi_diameter_mm": 8.0},
        ],
        "elements": [{"surfaces": [1], "pose": {"shift_mm": [0.0, 0.0, -1.0]}}],
    }  # fmt: skip
    return lf.Scene(camera=camera_without_array()).changed({"camera.lens": lens, "camera.focus_mm": 500.0})


def test_an_edge_between_posed_surfaces_that_dips_into_one_between_any_samples_is_refused() -> None:
    shape = lens_shape(solved_camera(shifted(3.0)).scene)
    outer, inner = shape.rims
    steeper = 0.5 * DIP * abs(bend_of(outer)) * (outer - inner)
    lens_shape(solved_camera(shifted(tangent_height(outer, inner) + steeper)).scene)
    with pytest.raises(lf.SceneError, match="edge between surfaces 0 and 1 cuts one of them"):
        lens_shape(solved_camera(shifted(tangent_height(outer, inner) - steeper)).scene)


def any_surface(draw: np.random.Generator) -> Any:
    """Return a random surface of any kind."""
    kind = int(draw.choice([0, 0, BICONIC, TOROID]))
    across = {"kind": kind, "radius_x_mm": float(draw.uniform(12.0, 60.0))} if kind else {}
    odd = [float(draw.normal()) * 5e-4] if not kind and draw.random() < 0.5 else []
    terms = () if kind == BICONIC else draw.normal(size=2) * [5e-5, 5e-7]
    radius = float(draw.choice([-1.0, 1.0]) * draw.uniform(12.0, 60.0))
    return surface(
        radius, float(draw.uniform(-1.5, 0.5)), terms, odd_mm=odd, vertex_z=float(draw.normal()),
        semi_diameter=float(draw.uniform(5.0, 8.0)), **across,
    )  # fmt: skip


def deepest(lines: np.ndarray, of: Any, rim: float, side: float, azimuths: int) -> float:
    """Return the least height over a surface of many points of edges and facets that count, mm."""
    t = np.linspace(0.0, 1.0, 401)[:, None]
    after, least = np.roll(lines[0], -1, axis=0), np.inf
    aperture = min(float(of["semi_diameter"]), rim * np.cos(np.pi / azimuths))
    share, inside = np.linspace(0.0, 1.0, 61), 1.0 - 1e-12
    u, v = (g[(np.add.outer(share, share) <= 1.0)][:, None] for g in np.meshgrid(share, share, indexing="ij"))
    for k in range(lines.shape[1]):
        low, high, beside, above = lines[0, k], lines[1, k], after[k], np.roll(lines[1], -1, axis=0)[k]
        parts = [(low + t * (high - low), rim)]
        parts += [(low + u * (high - low) + v * (beside - low), aperture)]
        parts += [(beside + u * (high - beside) + v * (above - beside), aperture)]
        for p, radius in parts:
            z = side * (p[:, 2] - of["vertex_z"] - mesh_heights(of, p[:, 0], p[:, 1]))
            least = min(least, float(z.min(where=np.hypot(p[:, 0], p[:, 1]) < inside * radius, initial=np.inf)))
    return least


def test_strips_that_are_said_to_clear_a_surface_do_and_others_come_near_it() -> None:
    draw = np.random.default_rng(11)
    count = {True: 0, False: 0}
    for _ in range(80):
        of, azimuths, side = any_surface(draw), 6, float(draw.choice([-1.0, 1.0]))
        rim = 1.02 * float(of["semi_diameter"]) / np.cos(np.pi / azimuths)
        phi = 2.0 * np.pi * np.arange(azimuths) / azimuths
        x, y = rim * np.cos(phi), rim * np.sin(phi)
        first = np.column_stack([x, y, of["vertex_z"] + mesh_heights(of, x, y)])
        # An edge begins on the rim, an annulus beside it.
        first[:, 2] += side * (draw.uniform(-0.4, 0.4) if draw.random() < 0.5 else 0.0)
        inner = float(draw.uniform(0.5, 1.2)) * rim
        x, y = inner * np.cos(phi) + 0.2 * draw.normal(), inner * np.sin(phi) + 0.2 * draw.normal()
        near = of["vertex_z"] + mesh_heights(of, x, y).mean()
        last = np.column_stack([x, y, np.full(azimuths, near + side * draw.uniform(-0.1, 1.0))])
        last[:, 2] += draw.normal() * 0.03 * x
        lines = np.stack([first, last])
        clear = stays_beside(lines, of, rim, side, azimuths)
        truth = deepest(lines, of, rim, side, azimuths)
        count[clear] += 1
        # A crossing between the points of the brute force is shallow.
        assert truth > -1e-7 if clear else truth < 1e-3, (of, truth)
    assert min(count.values()) > 12
