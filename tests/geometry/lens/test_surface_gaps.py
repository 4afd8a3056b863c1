"""Depths by which surfaces reach through each other: closed forms, and brute force over many points."""

import re
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.geometry.lens import surface_gaps
from lfmesh.geometry.lens.element_poses import refuse_crossing_elements
from lfmesh.geometry.lens.surface_gaps import end_where_they_touch, reaches_through
from lfmesh.geometry.surfaces.surface import BICONIC, put_in_pose, surface
from tests.cameras import camera_without_array

RIM = 12.0


def tilted_window(azimuth_deg: float, thickness_mm: float) -> lf.Scene:
    """Return a window the first face of which is tilted by 6 degrees, so that its rim is lowest at an azimuth."""
    way = np.deg2rad(azimuth_deg)
    tilt = [6.0 * float(np.sin(way)), -6.0 * float(np.cos(way)), 0.0]
    lens = {
        "surfaces": [
            {"thickness_mm": thickness_mm, "index": 1.5, "semi_diameter_mm": RIM, "stop": True},
            {"radius_mm": -80.0, "semi_diameter_mm": RIM + 1.0},
        ],
        "elements": [{"surfaces": [0], "pose": {"tilt_deg": tilt}}],
    }
    return lf.Scene(camera=camera_without_array()).changed({"camera.lens": lens, "camera.focus_mm": 500.0})


def refused_by_mm(scene: lf.Scene) -> float | None:
    """Return the depth in mm by which surfaces are said to cross."""
    try:
        lf.build(scene, aimed=False)
    except lf.SceneError as error:
        found = re.search(r"cross inside their clear apertures, by (\S+) mm", str(error))
        return None if found is None else float(found[1])
    return None


def test_a_rim_that_crosses_between_any_two_azimuths_is_found() -> None:
    """Between two of 96 azimuths a rim is up to 0.7 um lower: 1.875 degrees lies in the middle of two."""
    for azimuth in (1.875, 43.125, 178.125, 77.3):
        scene = tilted_window(azimuth, 1.0)
        turn = frame.rotation(scene.camera.lens.elements[0].pose.tilt_deg)
        # The rim's lowest point, less the sag of the second face under it, which stands upright.
        steep = np.hypot(turn[2, 0], turn[2, 1])
        place = RIM * np.sqrt(1.0 - steep**2)
        sag = 80.0 - np.sqrt(80.0**2 - place**2)
        for thickness in (RIM * steep + sag - 3e-4, RIM * steep + sag + 3e-4):
            said = refused_by_mm(tilted_window(azimuth, float(thickness)))
            # Along the axis of the tilted face, which meets the other at its slope.
            deep = 3e-4 / (np.sqrt(1.0 - steep**2) - steep * place / np.sqrt(80.0**2 - place**2))
            assert said == (pytest.approx(deep, rel=2e-3) if thickness < RIM * steep + sag else None)


def pair(draw: np.random.Generator) -> list[Any]:
    """Return two random surfaces, one behind the other, that are moved against each other."""
    found = []
    for k in (0, 1):
        odd = [float(draw.normal()) * 2e-4] if draw.random() < 0.3 else []
        more = {"kind": BICONIC, "radius_x_mm": float(draw.uniform(15.0, 60.0))} if draw.random() < 0.2 else {}
        radius = float(draw.choice([-1.0, 1.0]) * draw.uniform(12.0, 60.0))
        terms = () if more else draw.normal(size=2) * [2e-5, 2e-7]
        record = surface(
            radius, float(draw.uniform(-1.5, 0.5)), terms, odd_mm=() if more else odd,
            vertex_z=float(k * draw.uniform(0.5, 3.0)), semi_diameter=float(draw.uniform(4.0, 8.0)), **more,
        )  # fmt: skip
        turn, shift = frame.rotation(draw.normal(size=3) * [4.0, 4.0, 40.0]), draw.normal(size=3) * [0.5, 0.5, 0.2]
        put_in_pose(record, np.column_stack([turn, shift]))
        found.append(record)
    return found


def height(s: Any, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return z of a surface over its vertex by its formula."""
    cx = s["curvature_x"] if s["kind"] == BICONIC else s["curvature"]
    kx = s["conic_x"] if s["kind"] == BICONIC else s["conic"]
    root = np.sqrt(1.0 - (1.0 + kx) * cx**2 * x**2 - (1.0 + s["conic"]) * s["curvature"] ** 2 * y**2)
    z = (cx * x**2 + s["curvature"] * y**2) / (1.0 + root)
    r = np.hypot(x, y)
    z = z + sum(a * r ** (4 + 2 * n) for n, a in enumerate(s["asphere"][: s["terms"]]))
    return np.asarray(z + sum(a * r ** (3 + 2 * n) for n, a in enumerate(s["odd"][: s["odd_terms"]])))


def test_no_point_of_a_surface_is_deeper_in_another_than_is_said() -> None:
    draw = np.random.default_rng(5)
    crossed = 0
    for _ in range(60):
        one, other = pair(draw)
        said, possible = reaches_through(one, other, 1.0, 1e-9)
        r, phi = one["semi_diameter"] * np.sqrt(draw.random(40_000)), draw.uniform(0.0, 2.0 * np.pi, 40_000)
        r[:10_000] = one["semi_diameter"]
        x, y = r * np.cos(phi), r * np.sin(phi)
        p = np.column_stack([x, y, one["vertex_z"] + height(one, x, y)])
        q = (p @ one["pose"][:, :3].T + one["pose"][:, 3] - other["pose"][:, 3]) @ other["pose"][:, :3]
        inside = np.hypot(q[:, 0], q[:, 1]) <= other["semi_diameter"]
        q = q[inside]
        deepest = max(0.0, float((q[:, 2] - other["vertex_z"] - height(other, q[:, 0], q[:, 1])).max()))
        assert deepest <= said * 1.001 + 1e-9
        assert deepest <= possible + 1e-9
        # Points this dense lie near the deepest place.
        assert said <= deepest + 0.02
        crossed += deepest > 0.0
    assert 10 < crossed < 50


def test_what_is_not_proven_apart_may_cross(monkeypatch: pytest.MonkeyPatch) -> None:
    """However few squares are divided, no crossing is deeper than is said to be possible."""
    draw, truths, found, possible = np.random.default_rng(6), [], [], []
    pairs = [pair(draw) for _ in range(30)]
    for most, kept in ((surface_gaps.MOST_SQUARES, truths), (1, found), (1, possible)):
        monkeypatch.setattr(surface_gaps, "MOST_SQUARES", most)
        kept += [reaches_through(one, other, 1.0, 1e-9)[int(kept is possible)] for one, other in pairs]
    assert sum(truth > 1.01 * said for truth, said in zip(truths, found, strict=True)) > 3
    assert all(truth <= bound * 1.001 for truth, bound in zip(truths, possible, strict=True))


def test_elements_that_touch_all_over_are_refused_until_they_are_apart() -> None:
    """Spheres of one centre slide on each other: where one is tilted about it, no bound tells them from crossing."""

    def lens(gap_mm: float) -> lf.Scene:
        surfaces = [
            {"radius_mm": 40.0, "thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": 9.0, "stop": True},
            {"radius_mm": 30.0, "thickness_mm": gap_mm, "semi_diameter_mm": 9.0},
            {"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.6, "semi_diameter_mm": 9.0},
            {"radius_mm": 60.0, "semi_diameter_mm": 9.0},
        ]  # fmt: skip
        tilt = np.deg2rad(1.0)
        # About the vertex of surface 2, whose centre must stay.
        pose = {"tilt_deg": [1.0, 0.0, 0.0], "shift_mm": [0.0, 30.0 * np.sin(tilt), 30.0 * (1.0 - np.cos(tilt))]}
        given = {"surfaces": surfaces, "elements": [{"surfaces": [2, 3], "pose": pose}]}
        return lf.Scene(camera=camera_without_array()).changed({"camera.lens": given, "camera.focus_mm": 500.0})

    with pytest.raises(lf.SceneError, match="may cross, by up to") as refusal:
        refuse_crossing_elements(lf.solved(lens(0.0)).camera.lens)
    more = float(str(refusal.value).split("by up to ")[1].split(" mm")[0])
    assert more < 2e-3
    refuse_crossing_elements(lf.solved(lens(1.2 * more)).camera.lens)


def test_surfaces_that_touch_between_aperture_and_rim_end_there_though_they_are_apart_at_the_rim() -> None:
    """The gap is u + d ((r² − q²)² − w²): it closes between r² = q² − w and q² + w, 8.04 mm and 8.06 mm, only."""
    d, q2, w = 1e-4, 8.05**2, 0.16
    gap, slope, term = d * (q2**2 - w**2), -2.0 * d * q2, d
    for lifted in (0.0, 1.1 * d * w**2):
        front = surface(np.inf, semi_diameter=8.0)
        back = surface(0.5 / slope, -1.0, (term,), vertex_z=gap + lifted, semi_diameter=8.0)
        both = np.array([front, back])
        end_where_they_touch(both, 5)
        expected = np.sqrt(q2 - w) if lifted == 0.0 else np.inf
        np.testing.assert_allclose(both["end"], expected, rtol=1e-9)


def test_posed_surfaces_end_before_they_touch_at_any_azimuth_outside_their_apertures() -> None:
    for azimuth in (1.875, 43.125, 77.3):
        way = np.deg2rad(azimuth)
        turn = frame.rotation([2.0 * float(np.sin(way)), -2.0 * float(np.cos(way)), 0.0])
        steep = float(np.hypot(turn[2, 0], turn[2, 1]))
        front = surface(np.inf, semi_diameter=8.0)
        back = surface(np.inf, vertex_z=8.1 * steep, semi_diameter=8.0)
        put_in_pose(front, np.column_stack([turn, np.zeros(3)]))
        both = np.array([front, back])
        end_where_they_touch(both, 5)
        # The tilted face's lowest point is 8.1 mm from its vertex.
        assert np.all(both["end"] < 8.1 * (1.0 + 1e-8))
        np.testing.assert_allclose(both["end"], 8.1, rtol=2e-6)
