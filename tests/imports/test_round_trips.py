"""Random lenses written in each dialect and read again: surfaces, focal length and real rays are those of the scene."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.imports.conditions import Conditions, FieldPoint
from lfmesh.optics.glass import D_LINE_NM
from lfmesh.scene import Element, Paraxial, Pose
from lfmesh.scene.camera.lens import FileChoices
from lfmesh.scene.materials.coatings import Coating, Layer, MeasuredIndex
from lfmesh.scene.materials.own_glass import OwnGlass
from tests.imports.dialects import WRITTEN
from tests.instances import instances

SEMI = 4.0
SENSOR_MM = 70.0
SAME_MM, SAME_FOCAL, SAME_RAYS_MM = 1e-12, 1e-10, 1e-10
DIALECTS = (".zmx", ".seq")
"""That the package writes, too; the others are written by the tests."""
READ = (*DIALECTS, *WRITTEN)
COATED, ON_AXIS = (".zmx",), (".json", ".csv")
SHAPES = {
    ".zmx": ("sphere", "conic", "even", "long", "odd", "qcon", "qbfs", "biconic", "toroid"),
    ".seq": ("sphere", "conic", "even", "qcon", "qbfs"),
    ".len": ("sphere", "conic", "even", "long", "odd", "toroid"),
    ".json": ("sphere", "conic", "even", "long", "odd"),
    ".csv": ("sphere", "conic", "even", "long"),
}
"""Those that a dialect has."""

GLASSES: tuple[dict[str, Any], ...] = ({"glass": "SCHOTT/N-BK7"}, {"glass": "OHARA/S-LAH66"}, {"index": 1.61})
OWN: dict[str, dict[str, Any]] = {
    ".zmx": {"glass": OwnGlass(nd=1.62, vd=36.4)},
    ".seq": {"glass": OwnGlass(wavelengths_nm=(400.0, 500.0, 600.0, 800.0), values=(1.53, 1.523, 1.52, 1.512))},
}
OWN |= {".len": OWN[".seq"], ".json": OWN[".zmx"], ".csv": OWN[".zmx"]}
"""Glass of no catalogue that a dialect holds exactly."""


def shape(draw: np.random.Generator, ending: str) -> dict[str, Any]:
    """Return a random shape that a dialect has."""
    radius = math.inf if draw.random() < 0.1 else float(draw.choice([-1.0, 1.0]) * draw.uniform(15.0, 80.0))
    keys: dict[str, Any] = {"radius_mm": radius}
    kind = draw.choice(SHAPES[ending])
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


def coating(draw: np.random.Generator) -> Coating:
    """Return a random coating: a share, or up to four layers, some of which disperse and absorb."""
    if draw.random() < 0.3:
        return Coating(reflectance=float(draw.random()))
    layers = []
    for thickness in draw.uniform(5.0, 300.0, int(draw.integers(1, 5))):
        nm = np.sort(draw.uniform(350.0, 900.0, 3)).tolist()
        n, k = draw.uniform(1.3, 2.6, 3).tolist(), draw.uniform(0.0, 0.01, 3).tolist()
        film = MeasuredIndex(wavelengths_nm=nm, index=n, extinction=k)
        medium = {"measured": film} if draw.random() < 0.5 else {"index": n[0], "extinction": k[0]}
        layers.append(Layer(thickness_nm=float(thickness), **medium))
    return Coating(layers=tuple(layers))


def random_lens(seed: int, ending: str) -> lf.Lens:
    """Return a lens of two to four elements of glass, some off their places, some coated, the stop on some surface."""
    draw = np.random.default_rng(seed)
    surfaces: list[dict[str, Any]] = []
    elements = []
    glasses = (*GLASSES, OWN[ending])
    for number in range(int(draw.integers(2, 5))):
        if draw.random() < 0.5 and ending not in ON_AXIS:
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
    draw = np.random.default_rng([seed, 1])
    coatings = {f"c{i}": coating(draw) for i in range(len(surfaces)) if ending in COATED and draw.random() < 0.5}
    for name in coatings:
        surfaces[int(name[1:])]["coating"] = name
    made = tuple(lf.Surface(**keys) for keys in surfaces)
    return lf.Lens(name=f"random {seed}", surfaces=made, elements=elements, coatings=coatings)


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
    p = np.column_stack([draw.uniform(-1.5, 1.5, (200, 2)), np.full(200, -12.0 + shift_mm)])
    d = np.column_stack([draw.uniform(-0.05, 0.05, (200, 2)), np.ones(200)])
    world = lf.build(lf.Scene(camera=camera), aimed=False)
    paths = lf.trace(world, p, d, split="transmit", engine="sequential")
    landed = paths.status == lf.Status.SENSOR
    return paths.source[landed], paths.position[landed] - [0.0, 0.0, shift_mm]


def examine(seed: int, ending: str, path: Any) -> None:
    lens = random_lens(seed, ending)
    if ending in WRITTEN:
        path.write_text(WRITTEN[ending](lens))
    else:
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
        assert again.coatings.get(other.coating) == lens.coatings.get(one.coating)
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


@pytest.mark.parametrize("ending", instances(READ, long=[".zmx", ".len"]))
def test_the_lenses_have_all_that_a_dialect_has(ending: str) -> None:
    lenses = [random_lens(seed, ending) for seed in range(8)]
    surfaces = [surface for lens in lenses for surface in lens.surfaces]
    keys = {"conic": "conic", "even": "asphere_mm", "odd": "odd_asphere_mm"}
    for kind in SHAPES[ending]:
        empty = [(), None, 0.0]
        if kind == "sphere":
            assert any(not surface.terms_mm and not surface.conic for surface in surfaces)
        elif kind == "long":
            assert any(len(surface.asphere_mm) == 12 for surface in surfaces)
        else:
            assert any(getattr(surface, keys.get(kind, kind)) not in empty for surface in surfaces), kind
    assert any(math.isinf(surface.radius_mm) for surface in surfaces)
    assert {surface.medium for surface in surfaces} == {
        None,
        *(lf.Surface(semi_diameter_mm=1.0, **each).medium for each in (*GLASSES, OWN[ending])),
    }
    assert any(lens.elements for lens in lenses) == (ending not in ON_AXIS)
    assert any(lens.coatings for lens in lenses) == (ending in COATED)


@pytest.mark.parametrize("ending", READ)
@pytest.mark.parametrize("seed", range(6))
def test_random_lenses_come_back(seed: int, ending: str, tmp_path: Any) -> None:
    examine(seed, ending, tmp_path / f"lens{ending}")


@pytest.mark.long
@pytest.mark.parametrize("ending", READ)
@pytest.mark.parametrize("seed", range(6, 100))
def test_many_random_lenses_come_back(seed: int, ending: str, tmp_path: Any) -> None:
    examine(seed, ending, tmp_path / f"lens{ending}")


def other_state(lens: lf.Lens, seed: int) -> lf.Lens:
    """Return a lens with other thicknesses, and other radii and conics where nothing else depends on them."""
    draw = np.random.default_rng([seed, 2])
    surfaces = []
    for surface in lens.surfaces:
        new = {} if surface.thickness_mm is None else {"thickness_mm": float(draw.uniform(4.0, 6.0))}
        if math.isfinite(surface.radius_mm) and surface.qbfs is None and surface.qcon is None:
            new["radius_mm"] = 1.1 * surface.radius_mm
            new["conic"] = 0.9 * surface.conic
        surfaces.append(surface.model_copy(update=new))
    return lens.model_copy(update={"surfaces": tuple(surfaces)})


def operands(one: list[str], two: list[str], ending: str) -> Iterator[str]:
    """Yield the lines that give a file the values of another one as its second configuration."""
    number = -1
    names = {"DISZ": "THIC", "CURV": "CRVT", "CONI": "CONN"}
    for first, second in zip(one, two, strict=True):
        a, b = first.split(), second.split()
        number += a[0] in ("SURF", "SO", "S")
        if a == b:
            continue
        if ending == ".zmx":
            for k, words in enumerate((a, b), 1):
                yield f"{names[a[0]]} {number} {k} {words[1]} 0 0 0 1 1 1 0 0"
        elif a[0] == "S":
            yield f"ZOO RDY S{number} {a[1]} {b[1]}"
            yield f"ZOO THI S{number} {a[2]} {b[2]}"
        else:
            yield f"ZOO {a[0]} {f'S{number} ' if number >= 0 else ''}{a[1]} {b[1]}"


@pytest.mark.parametrize("ending", DIALECTS)
@pytest.mark.parametrize("seed", range(3))
def test_random_configurations_are_the_lenses_that_they_stand_for(seed: int, ending: str, tmp_path: Any) -> None:
    lens = random_lens(seed, ending)
    paths = [tmp_path / f"{name}{ending}" for name in ("one", "two")]
    texts = []
    for each, path in zip((lens, other_state(lens, seed)), paths, strict=True):
        write_lens_file(each, path)
        coding = "utf-16" if ending == ".zmx" else "utf-8"
        # The coatings are the same in both.
        texts.append([line for line in path.read_text(coding).split("\n") if line.strip() and "COFN" not in line])
    start, end = {".zmx": ("MNUM 2 1", "MNUM 1 1"), ".seq": ("ZOO 2", "GO")}[ending]
    both = [line for line in texts[0] if line.strip() != end] + [start, *operands(*texts, ending), "GO"]
    both.insert(1, 'COFN QF "one_coating.dat"') if lens.coatings else None
    zoom = tmp_path / f"zoom{ending}"
    zoom.write_text("\n".join(both))
    states = [read_lens_file(zoom, FileChoices(configuration=k))[0] for k in (1, 2)]
    assert states == [read_lens_file(path)[0] for path in paths]
    assert states[0] != states[1]


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
