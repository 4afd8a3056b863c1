"""Random lenses written in each dialect and read again: surfaces, focal length and real rays are those of the scene."""

import math
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.imports.conditions import Conditions, FieldPoint
from lfmesh.optics.glass import D_LINE_NM
from lfmesh.scene import Element, Paraxial, Pose
from lfmesh.scene.materials.own_glass import OwnGlass

SEMI = 4.0
SENSOR_MM = 70.0
SAME_MM, SAME_FOCAL, SAME_RAYS_MM = 1e-12, 1e-10, 1e-10
DIALECTS = (".zmx", ".seq")
ODD_AND_SECTIONS = (".zmx",)

GLASSES: tuple[dict[str, Any], ...] = ({"glass": "SCHOTT/N-BK7"}, {"glass": "OHARA/S-LAH66"}, {"index": 1.61})
OWN: dict[str, dict[str, Any]] = {
    ".zmx": {"glass": OwnGlass(nd=1.62, vd=36.4)},
    ".seq": {"glass": OwnGlass(wavelengths_nm=(400.0, 500.0, 600.0, 800.0), values=(1.53, 1.523, 1.52, 1.512))},
}
"""Glass of no catalogue that a dialect holds exactly."""


def shape(draw: np.random.Generator, ending: str) -> dict[str, Any]:
    """Return a random shape that a dialect has."""
    radius = math.inf if draw.random() < 0.1 else float(draw.choice([-1.0, 1.0]) * draw.uniform(15.0, 80.0))
    keys: dict[str, Any] = {"radius_mm": radius}
    kinds = ["sphere", "conic", "even", "qcon", "qbfs"]
    kinds += ["long", "odd", "biconic", "toroid"] if ending in ODD_AND_SECTIONS else []
    kind = draw.choice(kinds)
    if kind != "sphere":
        keys["conic"] = float(draw.uniform(-2.0, 0.5))
    terms = {"even": 4, "long": 12, "odd": 2, "toroid": 3}
    if kind in terms:
        powers = SEMI ** np.arange(4.0, 4.0 + 2 * terms[kind], 2.0)
        keys["asphere_mm"] = tuple((0.02 * draw.normal(size=terms[kind]) / powers).tolist())
    if kind == "odd":
        keys["odd_asphere_mm"] = tuple((0.02 * draw.normal(size=2) / SEMI ** np.array([3.0, 5.0])).tolist())
    if kind == "biconic":
        keys["biconic"] = {"radius_x_mm": float(draw.uniform(15.0, 80.0)), "conic_x": float(draw.uniform(-2.0, 0.5))}
    if kind == "toroid":
        keys["toroid"] = {"radius_x_mm": float(draw.choice([20.0, -30.0, math.inf]))}
    if kind in ("qcon", "qbfs"):
        keys[kind] = {"norm_radius_mm": 1.1 * SEMI, "coefficients_mm": (0.02 * draw.normal(size=3)).tolist()}
    return keys


def random_lens(seed: int, ending: str) -> lf.Lens:
    """Return a lens of two to four elements of glass, some of them off their places, with the stop on some surface."""
    draw = np.random.default_rng(seed)
    surfaces: list[dict[str, Any]] = []
    elements = []
    glasses = (*GLASSES, OWN[ending])
    for number in range(int(draw.integers(2, 5))):
        if draw.random() < 0.5:
            pose = Pose(shift_mm=draw.normal(size=3) * 0.05, tilt_deg=draw.normal(size=3))
            elements.append(Element(surfaces=(2 * number, 2 * number + 1), pose=pose))
        medium = glasses[int(draw.integers(len(glasses)))]
        surfaces.append(shape(draw, ending) | medium | {"thickness_mm": float(draw.uniform(4.0, 6.0))})
        surfaces.append(shape(draw, ending) | {"thickness_mm": float(draw.uniform(4.0, 6.0))})
    surfaces[-1].pop("thickness_mm")
    for surface in surfaces:
        surface["semi_diameter_mm"] = SEMI
    stop = surfaces[int(draw.integers(len(surfaces)))]
    stop |= {"stop": True, "semi_diameter_mm": 0.6 * SEMI}
    return lf.Lens(name=f"random {seed}", surfaces=tuple(lf.Surface(**keys) for keys in surfaces), elements=elements)


def standing_points(lens: lf.Lens) -> np.ndarray:
    """Return points of each surface, mm, in the camera frame."""
    heights = [(0.0, 0.0), (2.0, 0.0), (0.0, -1.7), (1.3, 1.9)]
    points = []
    for number, surface in enumerate(lens.surfaces):
        own = np.array([(x, y, surface.sag_at_mm(x, y) + lens.vertices_mm[number]) for x, y in heights])
        pose = pose_of(lens, number)
        points.append(own @ pose[:, :3].T + pose[:, 3])
    return np.array(points)


def landing(lens: lf.Lens, shift_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the rays that reach a sensor behind a lens, and where; the lens stands so far from its place."""
    behind = SENSOR_MM + shift_mm - lens.vertices_mm[-1]
    camera = {"lens": lens, "sensor": {"pixels": (800, 800), "pixel_mm": 0.5, "distance_mm": behind}}
    draw = np.random.default_rng(1)
    p = np.column_stack([draw.uniform(-1.5, 1.5, (40, 2)), np.full(40, -12.0 + shift_mm)])
    d = np.column_stack([draw.uniform(-0.05, 0.05, (40, 2)), np.ones(40)])
    world = lf.build(lf.Scene(camera=camera), aimed=False)
    paths = lf.trace(world, p, d, split="transmit", engine="sequential")
    landed = paths.status == lf.Status.SENSOR
    return paths.source[landed], paths.position[landed] - [0.0, 0.0, shift_mm]


def examine(seed: int, ending: str, path: Any) -> None:
    lens = random_lens(seed, ending)
    write_lens_file(lens, path)
    again, _ = read_lens_file(path)
    assert len(again.surfaces) == len(lens.surfaces)
    assert [s.stop for s in again.surfaces] == [s.stop for s in lens.surfaces]
    before, after = standing_points(lens), standing_points(again)
    # A lens read has its origin at its first vertex along the axis, a shift along z of the first element included.
    shift = after[-1, 0, 2] - before[-1, 0, 2]
    np.testing.assert_allclose(after - [0.0, 0.0, shift], before, atol=10.0 * SAME_MM, rtol=0.0)
    for one, other in zip(lens.surfaces, again.surfaces, strict=True):
        assert other.medium == one.medium
        assert other.semi_diameter_mm == pytest.approx(one.semi_diameter_mm, rel=1e-12)
        for x, y in ((0.0, 2.0), (2.2, 0.0), (1.5, -1.1)):
            assert other.sag_at_mm(x, y) == pytest.approx(one.sag_at_mm(x, y), abs=SAME_MM)
    if not lens.elements:
        focal = [Paraxial.of(each, D_LINE_NM).efl_mm for each in (lens, again)]
        assert focal[1] == pytest.approx(focal[0], rel=SAME_FOCAL)
    (rays, at), (same, there) = landing(lens, 0.0), landing(again, shift)
    assert len(rays) > 5
    np.testing.assert_array_equal(rays, same)
    np.testing.assert_allclose(there, at, atol=SAME_RAYS_MM)


@pytest.mark.parametrize("ending", DIALECTS)
@pytest.mark.parametrize("seed", range(6))
def test_random_lenses_come_back(seed: int, ending: str, tmp_path: Any) -> None:
    examine(seed, ending, tmp_path / f"lens{ending}")


@pytest.mark.long
@pytest.mark.parametrize("ending", DIALECTS)
@pytest.mark.parametrize("seed", range(6, 100))
def test_many_random_lenses_come_back(seed: int, ending: str, tmp_path: Any) -> None:
    examine(seed, ending, tmp_path / f"lens{ending}")


@pytest.mark.parametrize("ending", DIALECTS)
@pytest.mark.parametrize(("kind", "object_mm"), [("angle", math.inf), ("object", 250.0), ("image", 250.0)])
def test_light_fields_object_and_image_come_back(kind: str, object_mm: float, ending: str, tmp_path: Any) -> None:
    conditions = Conditions(
        (486.1327, 546.074, 656.2725), 1, kind, (FieldPoint(), FieldPoint(0.0, 2.5, 0.75, 1.0)), object_mm, 71.5
    )
    lens = random_lens(3, ending).model_copy(update={"elements": ()})
    path = tmp_path / f"lens{ending}"
    write_lens_file(lens, path, conditions)
    assert read_lens_file(path)[1].conditions == conditions
