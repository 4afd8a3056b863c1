"""The sequential engine against the mesh engine, ray by ray and picture by picture, on the image path.

The two meet the surfaces by different code: one by way of facets and Embree, one in their known order, in blocks.
"""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.transport.choice import engine_of

POSITION_MM = 1e-11
WEIGHT = 1e-12
RAYS = 4000
LENS_BODIES = {"stop", "mount", "housing"} | {f"lens[{i}] edge" for i in range(6)}


def lens(**changes):
    front = {"radius_mm": 42.0, "thickness_mm": 5.0, "index": 1.62, "semi_diameter_mm": 9.0} | changes
    return (
        lf.Surface(**front),
        lf.Surface(radius_mm=-150.0, thickness_mm=3.0, semi_diameter_mm=9.0),
        lf.Surface(stop=True, radius_mm=float("inf"), thickness_mm=2.5, semi_diameter_mm=5.5),
        lf.Surface(radius_mm=-60.0, thickness_mm=2.0, index=1.7, semi_diameter_mm=8.0),
        lf.Surface(radius_mm=70.0, thickness_mm=4.0, index=1.5, semi_diameter_mm=8.0),
        lf.Surface(radius_mm=-55.0, semi_diameter_mm=8.0),
    )


def array(**changes):
    given = {
        "layout": "square", "count": (160, 160), "pitch_mm": 0.125, "focal_length_mm": (0.5,), "index": 1.5,
        "thickness_mm": 0.3, "distance_mm": 60.0,
    } | changes  # fmt: skip
    return lf.MicrolensArray(**given)


def scene(surfaces, mla=None, **camera):
    sensor = {"pixels": (40, 40), "pixel_mm": 0.5, "distance_mm": 0.5 if mla is not None else 60.0}
    return lf.Scene(
        camera=lf.Camera(
            lens=lf.Lens(surfaces=surfaces), mla=mla, sensor=lf.Sensor(**sensor, **camera.pop("sensor", {})), **camera
        ),
        coatings=COATINGS,
    )


COATINGS = {
    "hard": {"layers": [{"index": 1.38, "thickness_nm": 106.5}, {"index": 2.1, "thickness_nm": 60.0}]},
    "sun": {"layers": [{"index": 1.46, "thickness_nm": 60.0}, {"index": 1.8, "extinction": 0.4, "thickness_nm": 45.0}]},
    "dim": {"layers": [{"index": 1.9, "extinction": 1e-6, "thickness_nm": 70.0}]},
}


PLANE = lf.Target(
    shape=lf.Plane(width_mm=60.0, height_mm=60.0),
    position_mm=(0.0, 0.0, -150.0),
    material=lf.Material(radiance_w_m2_sr=2.0),
)
ERRORS = lf.ArrayForm(decenter_mm=0.004, radius_error=0.05, pitch_error=0.003, seed=2)
TILTED = lf.Pose(shift_mm=(0.1, -0.2, 0.05), tilt_deg=(1.0, -1.5, 4.0))
RADIAL = {"kind": "radial", "coefficients_rad": [-800.0, 60.0], "radius_mm": 9.0}
LINES = {"kind": "grating", "lines_per_mm": 40.0, "direction_deg": 30.0}
IN_CELL = {"kind": "radial", "coefficients_rad": [-8.0, 0.5], "radius_mm": 0.0625}
METALENS = {"kind": "metalens", "focal_length_mm": 0.5, "design_nm": 587.6}
SCENES = {
    "spheres": scene(lens()),
    "conics": scene(lens(conic=-1.7)),
    "aspheres": scene(lens(conic=0.4, asphere_mm=(2e-6, -3e-9, 4e-12))),
    "square array": scene(lens(), array()),
    "square array of two types, curved towards the sensor": scene(
        lens(), array(focal_length_mm=(0.5, 0.4), curved_side="sensor")
    ),
    "hexagonal array of three types": scene(lens(), array(layout="hexagonal", focal_length_mm=(0.5, 0.45, 0.56))),
    "lenslets with form errors": scene(lens(), array(layout="hexagonal", form=ERRORS)),
    "diverging lenslets": scene(lens(), array(focal_length_mm=(-0.6,))),
    "coatings": scene(lens(coating="hard"), array(curved_coating="hard", flat_coating="hard")),
    "coatings that absorb": scene(
        lens(coating="sun", conic=-1.7), array(layout="hexagonal", curved_coating="sun", flat_coating="dim")
    ),
    "coatings and glass that absorb": scene(
        lens(coating="sun", index=None, glass="N-SF66"),
        array(index=None, glass="N-SF66", flat_coating="sun"),
        absorption=True,
    ),
    "all tilted": scene(lens(), array(layout="hexagonal", pose=TILTED), sensor={"pose": TILTED}),
    "a phase on a sphere": scene(lens(phase=RADIAL)),
    "a phase on an asphere, tilted": scene(lens(phase=RADIAL | {"order": -1}, asphere_mm=(2e-6,))).changed(
        {"camera.lens.elements": [{"surfaces": [0, 1], "pose": {"tilt_deg": [2.0, -3.0, 1.0]}}]}
    ),
    "a grating on the lens, and phases on both faces of the array": scene(
        lens(phase=LINES), array(layout="hexagonal", curved_phase=IN_CELL, flat_phase=IN_CELL, form=ERRORS)
    ),
    "a metalens array": scene(lens(), array(focal_length_mm=None, curved_phase=METALENS)),
    "a metalens array towards the sensor, tilted": scene(
        lens(), array(focal_length_mm=None, curved_phase=METALENS, curved_side="sensor", pose=TILTED)
    ),
    "phases under coatings that absorb": scene(
        lens(coating="sun", phase=RADIAL), array(curved_coating="sun", flat_coating="dim", curved_phase=IN_CELL)
    ),
}


def rays(world, backwards, count=RAYS, seed=11):
    """Rays that fill the pupil and a little more, from object space or from the sensor."""
    draw = np.random.default_rng(seed)
    camera = world.scene.camera
    z = camera.lens.vertices_mm
    if backwards:
        gap = (camera.sensor.distance_mm or 0.0) + (
            camera.mla.thickness_mm + camera.mla.distance_mm if camera.mla else 0.0
        )
        start = np.column_stack([draw.uniform(-8.0, 8.0, (count, 2)), np.full(count, z[-1] + gap - 0.02)])
        aim = np.column_stack([draw.uniform(-6.0, 6.0, (count, 2)), np.full(count, z[-1])])
    else:
        start = np.column_stack([draw.uniform(-7.0, 7.0, (count, 2)), np.full(count, -40.0)])
        aim = np.column_stack([draw.uniform(-8.0, 8.0, (count, 2)), np.full(count, 0.0)])
    return start, aim - start


@pytest.mark.parametrize("backwards", [False, True], ids=["to the sensor", "to object space"])
@pytest.mark.parametrize("name", SCENES)
def test_both_engines_take_a_ray_to_the_same_place(name, backwards):
    world = lf.build(SCENES[name])
    origins, directions = rays(world, backwards)
    mesh = lf.trace(world, origins, directions, split="transmit")
    path = lf.trace(world, origins, directions, split="transmit", engine="sequential")
    # Total reflection keeps its packet in one, and leaves the image path in the other; nothing else differs.
    ends = dict(zip(mesh.source, range(len(mesh)), strict=True))
    through = [body in ("sensor", "escaped") for body in path.body]
    assert np.mean(through) > 0.15
    absorbed_elsewhere = 0
    for i, source in enumerate(path.source):
        j = ends[source]
        if path.body[i] != mesh.body[j]:
            # Round the clear apertures bodies stand in each other's shadow, and a mesh's rim is a polygon.
            assert {path.body[i], mesh.body[j]} <= LENS_BODIES
            absorbed_elsewhere += 1
        if path.body[i] in LENS_BODIES:
            continue
        np.testing.assert_allclose(path.position[i], mesh.position[j], rtol=0, atol=POSITION_MM)
        np.testing.assert_allclose(path.direction[i], mesh.direction[j], rtol=0, atol=1e-12)
        assert abs(path.weight[i] - mesh.weight[j]) < WEIGHT
    assert absorbed_elsewhere < 0.05 * RAYS
    assert len(np.unique(path.source)) > 0.99 * RAYS
    assert abs(path.ledger.imbalance) < 1e-12


@pytest.mark.parametrize("backwards", [False, True], ids=["to the sensor", "to object space"])
@pytest.mark.parametrize("name", [name for name in SCENES if "absorb" in name])
def test_both_engines_enter_what_coatings_absorb_under_the_same_names(name, backwards):
    world = lf.build(SCENES[name])
    origins, directions = rays(world, backwards)
    mesh = lf.trace(world, origins, directions, split="transmit").ledger.absorbed
    path = lf.trace(world, origins, directions, split="transmit", engine="sequential").ledger.absorbed
    names = {name for name in mesh if name.startswith(("coating", "inside"))}
    assert names == {name for name in path if name.startswith(("coating", "inside"))}
    assert len(names) >= 2
    for name in names:
        assert path[name] == pytest.approx(mesh[name], rel=1e-3)
        assert path[name] > 0.0


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_a_ray_that_passes_the_lens_on_its_way_to_the_objects_goes_straight_on(engine):
    """Beside the barrel it comes through the corner of the box in which a lens is looked for, from behind."""
    world = lf.build(SCENES["spheres"])
    corner = np.array([8.5, 8.5, 0.5])
    direction = -np.array([1.0, -1.0, 0.05]) / np.linalg.norm([1.0, -1.0, 0.05])
    path = lf.trace(world, [corner - 8.0 * direction], [direction], split="transmit", engine=engine)
    assert path.body == ["escaped"]
    np.testing.assert_allclose(path.direction[0], direction, atol=1e-12)
    assert path.weight[0] == 1.0


def test_a_ray_does_not_depend_on_its_place_in_a_block():
    world = lf.build(SCENES["lenslets with form errors"])
    origins, directions = rays(world, False, 300)
    together = lf.trace(world, origins, directions, split="transmit", engine="sequential")
    for first in (0, 1, 129, 299):
        alone = lf.trace(world, origins[first:], directions[first:], split="transmit", engine="sequential")
        part = together.source >= first
        assert np.array_equal(alone.position, together.position[part])
        assert np.array_equal(alone.weight, together.weight[part])


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("name", ["conics", "hexagonal array of three types"])
def test_both_engines_make_the_same_picture(name, method):
    given = SCENES[name].changed(
        {
            "targets": [PLANE],
            "transport.method": method,
            "transport.split": "transmit",
            "transport.samples": 8,
            "transport.replicates": 2,
        }
    )
    mesh = lf.render(given.changed({"transport.engine": "mesh"}))
    path = lf.render(given.changed({"transport.engine": "sequential"}))
    assert (mesh.mean > 0.0).mean() > (0.5 if method == "adjoint" else 0.05)
    np.testing.assert_allclose(path.mean, mesh.mean, rtol=1e-10, atol=1e-10 * mesh.mean.max())
    assert abs(path.ledger.imbalance) < 1e-12


def test_auto_takes_the_sequential_engine_where_it_models_all_that_is_asked_for():
    given = SCENES["square array"]
    assert engine_of(given)[0] == "both"
    assert engine_of(given.changed({"transport.method": "forward"}))[0] == "mesh"
    alone = given.changed({"transport.split": "transmit"})
    assert engine_of(alone)[0] == "sequential"
    for changes, word in (
        ({"transport.surface": "flat"}, "flat"),
        ({"transport.max_events": 5}, "max_events"),
        ({"transport.engine": "mesh"}, "as the scene asks"),
    ):
        engine, why = engine_of(alone.changed(changes))
        assert engine == "mesh"
        assert word in why


@pytest.mark.parametrize(
    ("changes", "word"), [({"transport.surface": "smooth"}, "smooth"), ({"transport.max_events": 3}, "max_events")]
)
def test_the_sequential_engine_refuses_what_it_cannot_trace(changes, word):
    given = SCENES["square array"].changed({"transport.engine": "sequential"} | changes)
    with pytest.raises(lf.SceneError, match=rf'transport\.engine = "sequential".*{word}'):
        lf.render(given)


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"split": "both"}, "reflections"),
        ({"record": True}, "record"),
        ({"surface": "flat"}, "flat"),
        ({"engine": "quantum"}, "quantum"),
    ],
)
def test_a_sequential_trace_refuses_what_it_cannot_follow(settings, word):
    world = lf.build(SCENES["spheres"])
    with pytest.raises(lf.LfmeshError, match=word):
        lf.trace(world, [[0, 0, -9]], [[0, 0, 1]], **({"split": "transmit", "engine": "sequential"} | settings))
    with pytest.raises(lf.LfmeshError, match="starts inside the lens"):
        lf.trace(world, [[0, 0, 6.0]], [[0, 0, 1]], split="transmit", engine="sequential")
