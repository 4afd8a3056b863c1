"""The truth of the accuracy report against a trace in 30 digits, for every lens in assets and for lenslets."""

from typing import Any

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import lfmesh as lf
from lfmesh.accuracy import analytic
from lfmesh.accuracy.lens_accuracy import bare, bundle, lens_files, lens_scene
from lfmesh.assets import asset_path
from lfmesh.errors import LfmeshError
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import Scene, load_lens, solved

DIGITS = 30
RAYS = 12
"""Of each camera that get through."""

FEW_ROUNDINGS_MM = 2e-13
"""A float64 of 100 mm is rounded to 1.4e-14 mm, and a ray meets up to a dozen surfaces."""

Vector = list[Any]


def dot(a: Vector, b: Vector) -> Any:
    return mp.fsum(x * y for x, y in zip(a, b, strict=True))


def unit(a: Vector) -> Vector:
    length = mp.sqrt(dot(a, a))
    return [x / length for x in a]


def along(p: Vector, d: Vector, t: Any) -> Vector:
    return [x + t * y for x, y in zip(p, d, strict=True)]


def bent(d: Vector, normal: Vector, before: Any, after: Any) -> tuple[Vector, Any]:
    """Return the refracted direction, by angles in the plane of incidence, and the transmittance from sines."""
    if dot(d, normal) < 0:
        normal = [-x for x in normal]
    cos_i = dot(d, normal)
    tangent = [x - cos_i * n for x, n in zip(d, normal, strict=True)]
    sin_i = mp.sqrt(dot(tangent, tangent))
    i = mp.atan2(sin_i, cos_i)
    t = mp.asin(before / after * mp.sin(i))
    if sin_i == 0:
        return d, 4 * before * after / (before + after) ** 2
    tangent = unit(tangent)
    out = [mp.cos(t) * n + mp.sin(t) * x for n, x in zip(normal, tangent, strict=True)]
    # The paper's quotients of sines and tangents: R + T = 1.
    r_s, r_p = mp.sin(i - t) / mp.sin(i + t), mp.tan(i - t) / mp.tan(i + t)
    return out, 1 - (r_s**2 + r_p**2) / 2


def meet(p: Vector, d: Vector, height: Any) -> tuple[Vector, Vector]:
    """Return where a line meets the surface z = height(r²), found by bisection and secants, and its normal."""
    start = -p[2] / d[2]
    t = mp.findroot(lambda t: (q := along(p, d, t))[2] - height(q[0] ** 2 + q[1] ** 2), (start, start + mp.mpf("1e-3")))
    q = along(p, d, t)
    slope = 2 * mp.diff(height, q[0] ** 2 + q[1] ** 2)
    return q, unit([-slope * q[0], -slope * q[1], mp.mpf(1)])


def landing(scene: Scene, origin: NDArray[np.float64], direction: NDArray[np.float64]) -> tuple[Vector, Any]:
    """Return x, y on the sensor and the weight of a ray, in DIGITS digits, from the scene's own numbers."""

    def index(medium: Any) -> Any:
        return mp.mpf(refractive_index(medium, scene.primary_nm))

    lens, camera = scene.camera.lens, scene.camera
    p, d = [mp.mpf(float(x)) for x in origin], unit([mp.mpf(float(x)) for x in direction])
    weight, before, z = mp.mpf(1), mp.mpf(1), mp.mpf(0)
    for s, vertex in zip(lens.surfaces, lens.vertices_mm, strict=True):
        z = mp.mpf(vertex)
        after = index(s.medium)
        c, k = mp.mpf(s.curvature_per_mm), mp.mpf(s.conic)

        def height(r2: Any, c: Any = c, k: Any = k, s: Any = s) -> Any:
            conic = c * r2 / (1 + mp.sqrt(1 - (1 + k) * c * c * r2))
            return conic + mp.fsum(mp.mpf(a) * r2 ** (j + 2) for j, a in enumerate(s.asphere_mm))

        q, normal = meet([p[0], p[1], p[2] - z], d, height)
        p = [q[0], q[1], q[2] + z]
        if after != before:
            d, share = bent(d, normal, before, after)
            weight *= share
        before = after
    if camera.mla is not None:
        z += mp.mpf(camera.mla.distance_mm)
        p, d, share = through_lenslets(scene, p, d, z, index(camera.mla.medium))
        weight *= share
        z += mp.mpf(camera.mla.thickness_mm)
    z += mp.mpf(camera.sensor.distance_mm)
    return along(p, d, (z - p[2]) / d[2])[:2], weight


def through_lenslets(scene: Scene, p: Vector, d: Vector, z: Any, glass: Any) -> tuple[Vector, Vector, Any]:
    """Take a ray through an untilted array whose curved face is at z or a thickness behind it.

    Of three kinds of lenslet in a hexagonal array no two neighbours are alike: a step along a row, or to the next one,
    leads to the next kind.
    """
    mla = scene.camera.mla
    assert mla is not None
    to_lens = mla.curved_side == "lens"
    thickness, pitch = mp.mpf(mla.thickness_mm), mp.mpf(mla.pitch_mm)
    sign = 1 if to_lens else -1
    flat = [mp.mpf(0), mp.mpf(0), mp.mpf(1)]
    weight = mp.mpf(1)
    if not to_lens:
        p = along(p, d, (z - p[2]) / d[2])
        d, weight = bent(d, flat, mp.mpf(1), glass)
    face = z if to_lens else z + thickness
    best = None
    columns, rows = mla.count
    near = along(p, d, (face - p[2]) / d[2])
    # Every lenslet near by is tried; the ray goes through the one whose own centre is the nearest to the hit.
    centres = []
    for row in range(rows):
        shift = mp.mpf("0.5") * (row % 2) if mla.layout == "hexagonal" else 0
        spacing = mp.sqrt(3) / 2 if mla.layout == "hexagonal" else 1
        mean = mp.mpf("0.25") if mla.layout == "hexagonal" and rows > 1 else 0
        for column in range(columns):
            x, y = column - mp.mpf(columns - 1) / 2 + shift - mean, (row - mp.mpf(rows - 1) / 2) * spacing
            if abs(x * pitch - near[0]) < 2 * pitch and abs(y * pitch - near[1]) < 2 * pitch:
                kind = (column - row // 2 + 2 * row) % len(mla.radius_mm)
                centres.append((x * pitch, y * pitch, sign / mp.mpf(mla.radius_mm[kind])))
    for centre in centres:
        c = centre[2]
        from_middle = [p[0] - centre[0], p[1] - centre[1], p[2] - face - 1 / c]
        b = dot(from_middle, d)
        square = b * b - dot(from_middle, from_middle) + 1 / c**2
        if square < 0:
            continue
        hits = [along(from_middle, d, root - b) for root in (mp.sqrt(square), -mp.sqrt(square))]
        q = min(hits, key=lambda q: abs(q[2] + 1 / c))
        normal = unit([-c * x for x in q])
        q = [q[0], q[1], q[2] + 1 / c]
        hit = [q[0] + centre[0], q[1] + centre[1], q[2] + face]
        if min(centres, key=lambda o: (o[0] - hit[0]) ** 2 + (o[1] - hit[1]) ** 2) == centre:
            assert best is None
            best = hit, normal
    assert best is not None
    p, normal = best
    d, share = bent(d, normal, mp.mpf(1) if to_lens else glass, glass if to_lens else mp.mpf(1))
    weight *= share
    if to_lens:
        p = along(p, d, (z + thickness - p[2]) / d[2])
        d, share = bent(d, flat, glass, mp.mpf(1))
        weight *= share
    return p, d, weight


def assert_agrees(scene: Scene, mean_weight: tuple[float, float]) -> None:
    """Compare rays from all over the field, in position and weight; and the error that the truth says it has."""
    wavelength = scene.primary_nm
    sent = bundle(scene, 400, seed=5)
    truth = analytic.Camera.of(scene, wavelength).land(*sent)
    which = np.flatnonzero(truth.arrives)[:RAYS]
    assert len(which) == RAYS
    with mp.workdps(DIGITS):
        exact = [landing(scene, sent.origins[i], sent.directions[i]) for i in which]
        off = [
            float(mp.hypot(x - mp.mpf(float(px)), y - mp.mpf(float(py))))
            for ((x, y), _), (px, py) in zip(exact, truth.position[which], strict=True)
        ]
        weights = [float(w) for _, w in exact]
    assert max(off) < FEW_ROUNDINGS_MM
    np.testing.assert_allclose(truth.weight[which], weights, rtol=1e-13)
    assert mean_weight[0] < np.mean(weights) < mean_weight[1]
    claimed = analytic.own_error(scene, wavelength, sent.origins[which], sent.directions[which])
    if claimed is not None:
        # Not quite the same: the sum of the spaces between surfaces is rounded before either trace begins.
        assert 0.5 * max(off) < claimed < 2.0 * max(off)


# Gradient-index glass has its closed forms in `test_analytic_gradients.py`.
@pytest.mark.parametrize(
    "file", [file for file in lens_files() if not load_lens(file).has_gradients], ids=lambda file: file.stem
)
def test_truth_lands_where_30_digits_do(file: Any) -> None:
    assert_agrees(lens_scene(file), (0.4, 0.95))


@pytest.mark.parametrize("scene", ["first_light", "hexagonal"])
@pytest.mark.parametrize("side", ["lens", "sensor"])
def test_truth_through_the_lenslets_lands_where_30_digits_do(scene: str, side: str) -> None:
    camera = lf.load(asset_path(f"scenes/{scene}.toml")).changed({"camera.mla.curved_side": side})
    assert_agrees(bare(camera), (0.4, 0.95))


def test_a_pose_turns_about_x_then_y_then_z_and_shifts() -> None:
    scene = bare(lf.load(asset_path("scenes/first_light.toml")))
    pose = {"shift_mm": [0.3, -0.2, 0.1], "tilt_deg": [2.0, -3.0, 5.0]}
    turn = Rotation.from_euler("xyz", pose["tilt_deg"], degrees=True).as_matrix()
    still = analytic.Camera.of(scene, 587.6)
    moved = analytic.Camera.of(scene.changed({"camera.mla.pose": pose, "camera.sensor.pose": pose}), 587.6)
    assert still.mla is not None
    assert moved.mla is not None
    np.testing.assert_allclose(moved.mla.turn, turn, atol=1e-15)
    np.testing.assert_allclose(moved.sensor_turn, turn, atol=1e-15)
    np.testing.assert_allclose(moved.mla.origin - still.mla.origin, pose["shift_mm"], atol=1e-13)
    np.testing.assert_allclose(moved.sensor_origin - still.sensor_origin, pose["shift_mm"], atol=1e-13)


def test_an_aperture_stops_what_lies_outside_it() -> None:
    scene = lens_scene(asset_path("lenses/plano_convex_25mm.toml"))
    radius = scene.camera.lens.surfaces[0].semi_diameter_mm or 0.0
    heights = np.array([0.0, 0.999, 1.001]) * radius
    origins = np.column_stack([heights, 0.0 * heights, np.full(3, -20.0)])
    landed = analytic.Camera.of(scene, 587.6).land(origins, np.tile([0.0, 0.0, 1.0], (3, 1)))
    np.testing.assert_array_equal(landed.arrives, [True, True, False])
    assert np.isnan(landed.position[2]).all()


def test_a_lens_from_a_mesh_has_no_analytic_truth() -> None:
    scene = solved(lens_scene(asset_path("lenses/ball_10mm.toml")))
    surfaces = scene.camera.lens.surfaces
    assert all(surface.mesh is None for surface in surfaces)
    shape = surfaces[0].model_copy(update={"mesh": object()})
    lens = scene.camera.lens.model_copy(update={"surfaces": (shape, *surfaces[1:])})
    meshed = scene.model_copy(update={"camera": scene.camera.model_copy(update={"lens": lens})})
    with pytest.raises(LfmeshError, match=r"camera\.lens\.surfaces\[0\]: a mesh from a file"):
        analytic.Camera.of(meshed, 587.6)


def test_tilted_and_decentred_elements_land_where_the_tracer_has_them() -> None:
    """Two programs that share no code place the same elements."""
    pose = {"tilt_deg": [2.0, 1.0, 40.0], "shift_mm": [0.2, 0.1, 0.3]}
    scene = lf.load(asset_path("scenes/conventional.toml")).changed(
        {
            "targets": [],
            "lights": [],
            "camera.lens.elements": [
                {"surfaces": [6, 7, 8, 9, 10], "pose": pose},
                {"surfaces": [5], "pose": {"tilt_deg": [0.0, 3.0, 0.0], "shift_mm": [0.3, 0.0, 0.0]}},
            ],
        }
    )
    draw = np.random.default_rng(3)
    origins = np.column_stack([draw.uniform(-30.0, 30.0, (1000, 2)), np.full(1000, -500.0)])
    ahead = np.column_stack([draw.uniform(-7.0, 7.0, (1000, 2)), np.full(1000, 20.0)]) - origins
    landing = analytic.Camera.of(scene, 587.6).land(origins, ahead)
    paths = lf.trace(lf.build(scene), origins, ahead, split="transmit")
    there = np.isin(paths.body, ["sensor", "beside the sensor"])
    np.testing.assert_array_equal(np.sort(paths.source[there]), np.flatnonzero(landing.arrives))
    assert there.sum() > 300
    assert np.abs(paths.position[there][:, :2] - landing.position[paths.source[there]]).max() < FEW_ROUNDINGS_MM
    assert np.abs(paths.weight[there] - landing.weight[paths.source[there]]).max() < 1e-12


@pytest.mark.parametrize(
    ("side", "mla"),
    [
        (
            "lens",
            {
                "layout": "hexagonal",
                "focal_length_mm": [0.375, 0.45, -0.5],
                "conic": [-1.5, 0.0, 0.2],
                "asphere_mm": [[], [0.4], [-0.3, 1.0]],
            },
        ),
        ("sensor", {"conic": -2.0, "form": {"decenter_mm": 0.003, "radius_error": 0.05, "seed": 2}}),
        ("lens", {"focal_length_mm": [0.375, 0.5], "conic": -1.0, "cylinder_axis": "x"}),
    ],
    ids=["three aspheres", "hyperboloids with form errors", "acylinders"],
)
def test_lenslets_that_are_no_spheres_land_where_the_tracer_has_them(side: str, mla: dict[str, Any]) -> None:
    """Two programs that share no code bend rays at the same faces."""
    changes = {f"camera.mla.{key}": value for key, value in mla.items()} | {"camera.mla.curved_side": side}
    scene = lf.load(asset_path("scenes/focused.toml")).changed(changes | {"targets": [], "lights": []})
    draw = np.random.default_rng(4)
    origins = np.column_stack([draw.uniform(-20.0, 20.0, (1000, 2)), np.full(1000, -300.0)])
    ahead = np.column_stack([draw.uniform(-7.0, 7.0, (1000, 2)), np.full(1000, 10.0)]) - origins
    landing = analytic.Camera.of(scene, 587.6).land(origins, ahead)
    paths = lf.trace(lf.build(scene, aimed=False), origins, ahead, split="transmit")
    there = np.isin(paths.body, ["sensor", "beside the sensor"])
    both = there & landing.arrives[paths.source]
    assert both.sum() > 300
    # What only one of them has at the sensor crosses the layer of faces from cell to cell.
    assert both.sum() > 0.98 * max(there.sum(), landing.arrives.sum())
    assert np.abs(paths.position[both][:, :2] - landing.position[paths.source[both]]).max() < FEW_ROUNDINGS_MM
    assert np.abs(paths.weight[both] - landing.weight[paths.source[both]]).max() < 1e-12
