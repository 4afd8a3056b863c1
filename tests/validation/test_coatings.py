"""Coated cameras against the package `tmm`: what is left of light along its path is the product of the shares there.

The truth knows the prescription, where a recorded path has its vertices, and what `tmm` says of the layers; it knows no
tables, and nothing of how packets are divided.
"""

from functools import cache

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens
from lfmesh.view.rays.ghosts import ghost_matrix
from lfmesh.view.rays.launch import from_field_point
from lfmesh.view.rays.names import lens_names
from tests.cameras import camera_without_array, close_up_camera
from tests.instances import instances

tmm = pytest.importorskip("tmm")

WAVELENGTH = 587.6
COATINGS = {
    "single": [{"index": 1.38, "thickness_nm": 106.5}],
    "sun": [{"index": 1.46, "thickness_nm": 60.0}, {"index": 1.8, "extinction": 0.4, "thickness_nm": 45.0}],
}
POINT = (60.0, 40.0, -500.0)
CUTOFF = 1e-7
"""Weights below are left to the roulette."""


def double_gauss(coating):
    """A double Gauss whose air faces have a coating."""
    lens = load_lens(asset_path("lenses/double_gauss_50mm.toml"))
    surfaces, before = [], None
    for surface in lens.surfaces:
        faces_air = (before is None) != (surface.medium is None)
        surfaces.append(surface.model_copy(update={"coating": coating if faces_air else "none"}))
        before = surface.medium
    return lf.Scene(
        camera={
            "lens": lens.model_copy(update={"surfaces": tuple(surfaces)}), "focus_mm": 500.0,
            "sensor": {"pixels": [400, 300], "pixel_mm": 0.08},
        },
        coatings={name: {"layers": layers} for name, layers in COATINGS.items()},
        transport={"wavelengths_nm": [WAVELENGTH]},
    )  # fmt: skip


def shares_of(scene, number, cosine, to_sensor):
    """Reflectance and transmittance at a surface of the prescription, by tmm."""
    surfaces = scene.camera.lens.surfaces
    before = surfaces[number - 1].index or 1.0 if number else 1.0
    behind = surfaces[number].index or 1.0
    layers = [] if surfaces[number].coating == "none" else COATINGS[surfaces[number].coating]
    # Listed from the air side.
    layers = layers[::-1] if behind == 1.0 else layers
    indices = [before, *(layer["index"] + 1j * layer.get("extinction", 0.0) for layer in layers), behind]
    thicknesses = [np.inf, *(layer["thickness_nm"] for layer in layers), np.inf]
    if not to_sensor:
        indices, thicknesses = indices[::-1], thicknesses[::-1]
    found = tmm.unpolarized_RT(indices, thicknesses, np.arccos(cosine), WAVELENGTH)
    return found["R"], found["T"]


def products(world, rays, paths):
    """Return the product of the shares along recorded paths, from tmm."""
    scene, made = world.scene, []
    lens, z = scene.camera.lens, scene.camera.lens.vertices_mm
    numbers = dict(
        zip([rays.surfaces.index(name) for name in lens_names(world)], world.lens_shape.numbers, strict=True)
    )
    for path in paths:
        product = 1.0
        for vertex in range(rays.offsets[path] + 1, rays.offsets[path + 1] - 1):
            number = numbers[int(rays.surface[vertex])]
            step = rays.position[vertex] - rays.position[vertex - 1]
            radius, p = lens.surfaces[number].radius_mm, rays.position[vertex]
            normal = (np.array([0.0, 0.0, z[number] + radius]) - p) / radius
            cosine = abs(step @ normal) / np.linalg.norm(step)
            R, T = shares_of(scene, number, min(cosine, 1.0), step[2] > 0.0)
            product *= R if rays.reflected[vertex] else T
        made.append(product)
    return np.array(made)


@cache
def launched(coating):
    world = lf.build(double_gauss(coating))
    return world, from_field_point(world, POINT, 60, aim="lens", weight_cutoff=CUTOFF, seed=3)


@pytest.fixture(scope="module")
def bare():
    return launched("none")


@pytest.mark.parametrize("coating", instances(COATINGS, long=["single"]))
def test_what_arrives_is_the_product_of_reflectances_and_transmittances_along_the_path(coating):
    world, rays = launched(coating)
    arrives = np.flatnonzero(rays.arrives & (rays.count_vertices(rays.reflected) <= 2))
    assert (rays.count_vertices(rays.reflected)[arrives] == 2).sum() > 50
    assert (rays.count_vertices(rays.reflected)[arrives] == 0).sum() > 10
    truth = products(world, rays, arrives)
    started = rays.power[rays.offsets[:-1]][arrives]
    found, followed = rays.end_power[arrives] / started, truth > CUTOFF
    assert followed.mean() > 0.5
    np.testing.assert_allclose(found[followed], truth[followed], rtol=1e-5)


def test_the_strongest_ghost_changes_by_the_products_along_it(bare):
    world, rays = bare
    coated_world, coated_rays = launched("single")
    names = ghost_matrix(rays).names
    first, second, power = ghost_matrix(rays).strongest(1)[0]
    cell = names.index(first), names.index(second)
    at = [rays.surfaces.index(name) for name in (first, second)]
    two = np.flatnonzero(rays.arrives & (rays.count_vertices(rays.reflected) == 2))
    mirrors = rays.keep(np.isin(np.arange(len(rays)), two))
    own = two[(mirrors.surface[mirrors.reflected].reshape(-1, 2) == at).all(axis=1)]
    change = products(coated_world, rays, own) / products(world, rays, own)
    expected = (rays.end_power[own] * change).sum() / power
    found = ghost_matrix(coated_rays).power[cell] / power
    assert found == pytest.approx(expected, rel=1e-3)
    # The film takes nine tenths of it and more.
    assert found < 0.1


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("split", ["both", "roulette", "transmit"])
def test_what_a_coating_absorbs_is_in_the_ledger(method, split):
    camera = close_up_camera()
    surfaces = [dict(surface) for surface in camera["lens"]["surfaces"]]
    surfaces[0]["coating"] = surfaces[1]["coating"] = "sun"
    faces = {"flat_coating": "sun"}
    scene = lf.Scene(
        camera=camera | {"lens": camera["lens"] | {"surfaces": surfaces}, "mla": camera["mla"] | faces},
        targets=[{
            "shape": {"kind": "plane", "width_mm": 6.0, "height_mm": 5.0}, "position_mm": [0, 0, -60.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
        }],
        coatings={"sun": {"layers": COATINGS["sun"]}},
        transport={"method": method, "split": split, "samples": 8, "replicates": 2, "threads": 1},
    )  # fmt: skip
    image = lf.render(scene)
    engine = "sequential" if split == "transmit" else ("both" if method == "adjoint" else "mesh")
    assert image.engine.startswith(f"{engine}: ")
    assert abs(image.ledger.imbalance) < 1e-12
    taken = {name: value for name, value in image.ledger.absorbed.items() if name.startswith("coating of ")}
    lens = [i for i, surface in enumerate(surfaces) if "coating" in surface]
    assert set(taken) == {*(f"coating of lens surface {i}" for i in lens), "coating of the mla's flat face"}
    assert all(value > 0.0 for value in taken.values())


GLASS = 1.52
CENTRE = np.array([0.0, 0.0, -300.0])


def plates(tmp_path, liquid, coating, reach=(6.2, 7.5), layers=COATINGS["sun"]):
    """A world with two plates of coated glass across the x axis, liquid between them that may reach into them."""
    targets = []
    edges = [(-8.0, -5.0), (-reach[0], reach[1]), (6.0, 10.0)]
    for k, ((low, high), index) in enumerate(zip(edges, [GLASS, liquid, GLASS], strict=True)):
        side = 50.0 if k == 1 and reach[0] > 5.0 else 60.0
        trimesh.creation.box((high - low, side, side)).export(tmp_path / f"{k}.stl")
        own = {"file": str(tmp_path / f"{k}.stl"), "units": "mm", "index": index, "surface": "flat"}
        own |= {"priority": -1} if k == 1 else {"coating": coating}
        targets.append({"refractor": own, "position_mm": [0.5 * (low + high), 0.0, -300.0]})
    return lf.build(
        lf.Scene(
            camera={
                "focus_mm": 150.0, "sensor": {"pixels": [6, 6], "pixel_mm": 1.5},
                "lens": {"surfaces": [
                    {"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 6.0, "stop": True},
                    {"radius_mm": -30.0, "semi_diameter_mm": 6.0},
                ]},
            },
            targets=targets, coatings={"film": {"layers": layers}}, transport={"wavelengths_nm": [WAVELENGTH]},
        )
    )  # fmt: skip


def through_film(n_i, n_t, layers, sine):
    """Transmittance by tmm at the sine of the angle in air; the layers as light meets them."""
    indices = [n_i, *(layer["index"] + 1j * layer.get("extinction", 0.0) for layer in layers), n_t]
    thicknesses = [np.inf, *(layer["thickness_nm"] for layer in layers), np.inf]
    return np.array([tmm.unpolarized_RT(indices, thicknesses, np.arcsin(s / n_i), WAVELENGTH)["T"] for s in sine])


@pytest.mark.parametrize(
    ("liquid", "layers"), [(1.333, COATINGS["sun"]), (GLASS, COATINGS["sun"]), (GLASS, COATINGS["single"])]
)
def test_a_coated_body_of_glass_has_its_coating_towards_air_and_towards_a_liquid_round_it(tmp_path, liquid, layers):
    """The faces of the liquid that lie in the glass are none; with equal indices the coating alone is left."""
    world = plates(tmp_path, liquid, "film", layers=layers)
    sine = np.linspace(0.0, 0.8, 40)
    d = np.column_stack([np.sqrt(1.0 - sine**2), sine, np.zeros(40)])
    paths = lf.trace(
        world, CENTRE + np.array([-8.0, 0.7, 0.3]) - 20.0 * d, d, wavelength_nm=WAVELENGTH, split="transmit"
    )
    assert (paths.status == lf.Status.ESCAPED).all()
    assert (paths.events == 4).all()
    inward, outward = layers, layers[::-1]
    truth = through_film(1.0, GLASS, inward, sine) * through_film(GLASS, liquid, outward, sine)
    truth *= through_film(liquid, GLASS, inward, sine) * through_film(GLASS, 1.0, outward, sine)
    np.testing.assert_allclose(paths.weight, truth, rtol=1e-6)
    taken = sum(v for name, v in paths.ledger.absorbed.items() if name.startswith("coating of "))
    assert (taken > 0.1) == (layers is COATINGS["sun"])
    assert abs(paths.ledger.imbalance) < 1e-12


def test_a_coated_body_that_touches_another_is_refused(tmp_path):
    with pytest.raises(lf.SceneError, match=r'refractor\.coating = "film": a coated body must not touch another'):
        plates(tmp_path, 1.333, "film", reach=(5.0, 6.0))
    plates(tmp_path, 1.333, "none", reach=(5.0, 6.0))


def test_both_engines_pass_the_same_light_through_coated_surfaces():
    """Spheres, a conic, an asphere and both faces of the array, packet by packet and in blocks."""
    broad = [{"index": 1.38, "thickness_nm": 99.6}, {"index": 2.05, "thickness_nm": 134.1}]
    camera = close_up_camera()
    surfaces = [dict(surface) for surface in camera["lens"]["surfaces"]]
    surfaces[0] |= {"coating": "film", "conic": -0.5, "asphere_mm": [1e-6]}
    surfaces[1] |= {"coating": "film"}
    faces = {"curved_coating": "film", "flat_coating": "film"}
    scene = lf.Scene(
        camera=camera | {"lens": {"surfaces": surfaces}, "mla": camera["mla"] | faces},
        coatings={"film": {"layers": broad}}, transport={"wavelengths_nm": [WAVELENGTH]},
    )  # fmt: skip
    draw = np.random.default_rng(6)
    count = 400
    origins = np.column_stack([draw.uniform(-2.0, 2.0, (count, 2)), np.full(count, -60.0)])
    d = np.column_stack([draw.uniform(-3.0, 3.0, (count, 2)), np.zeros(count)]) - origins
    ends = [
        lf.trace(lf.build(scene.changed({"transport.engine": engine})), origins, d, WAVELENGTH, split="transmit")
        for engine in ("mesh", "sequential")
    ]
    weights = [np.zeros(count), np.zeros(count)]
    for kept, paths in zip(weights, ends, strict=True):
        arrives = paths.status == lf.Status.SENSOR
        kept[paths.source[arrives]] = paths.weight[arrives]
    assert (weights[0] > 0.0).sum() > 200
    np.testing.assert_allclose(*weights, rtol=1e-9)
    bare = lf.trace(
        lf.build(scene.changed({"coatings.film": {"reflectance": 0.0}})), origins, d, WAVELENGTH, split="transmit"
    )
    assert bare.weight[bare.status == lf.Status.SENSOR].min() == 1.0


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_a_layer_of_the_index_of_both_glasses_is_no_layer(engine):
    camera = camera_without_array()
    front, back = camera["lens"]["surfaces"]
    inside = front | {"stop": False, "coating": "matched"}
    layers = [{"index": front["index"], "thickness_nm": 200.0}]
    scene = lf.Scene(
        camera=camera | {"lens": {"surfaces": [front, inside, back]}},
        coatings={"matched": {"layers": layers}}, transport={"wavelengths_nm": [WAVELENGTH]},
    )  # fmt: skip
    bare = scene.changed({"camera.lens.surfaces.1.coating": "none"})
    weights = [
        lf.trace(lf.build(it), [[0.1, 0.2, -5.0]], [[0.0, 0.01, 1.0]], WAVELENGTH, split="transmit", engine=engine)
        for it in (scene, bare)
    ]
    assert [paths.status.tolist() for paths in weights] == [[lf.Status.SENSOR]] * 2
    assert weights[0].weight == pytest.approx(weights[1].weight, rel=1e-12)
