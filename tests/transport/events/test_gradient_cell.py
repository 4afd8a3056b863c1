"""Rays through arrays of gradient-index lenslets, against closed forms and against homogeneous plates.

In n² = n₀² (1 − g² r²) height and optical momentum are harmonic in σ, with dσ = ds/n (E. W. Marchand, Gradient Index
Optics, Academic Press, 1978, chapter 5). So the largest height over any wall of a cell is known, too.
"""

from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.errors import LfmeshError, SceneError
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.transport import trace as trace_module
from lfmesh.transport.choice import engine_of
from tests.renders import unchecked

Array = NDArray[np.float64]

N0, G, LENGTH, PITCH = 1.6, 0.5, 7.0, 1.0
LENS_END, BEFORE, TO_SENSOR = 1.0, 2.0, 1.5
"""Rear vertex of the window, and the gaps before and behind the array, mm."""

TRACED_MM = 5e-9
"""Error of a place on the sensor: the tracer steps to 1e-9 mm at the rear face, and slopes carry it on."""

ROUNDING = 1e-12
LEVEL = 1e-3
RAYS = 400
RODS = {"kind": "radial_n2", "index": N0, "coefficients": [-(G**2)]}
FLAT = {"kind": "radial_n2", "index": N0, "coefficients": [0.0]}


def camera(**mla: Any) -> lf.Scene:
    """Return a camera with a plane window in place of a lens, and an array of 7 × 6 cells before a wide sensor."""
    window = [
        {"thickness_mm": LENS_END, "index": 1.5, "semi_diameter_mm": 20.0},
        {"semi_diameter_mm": 20.0, "stop": True},
    ]
    array = {"count": [7, 6], "pitch_mm": PITCH, "thickness_mm": LENGTH, "distance_mm": BEFORE, "gradient": RODS}
    return lf.Scene(
        camera={
            "lens": {"surfaces": window},
            "mla": {key: value for key, value in (array | mla).items() if value is not None},
            "sensor": {"pixels": [100, 100], "pixel_mm": 0.5, "distance_mm": TO_SENSOR},
        }
    )


class Rays(NamedTuple):
    """Rays that arrive on the front face of an array, with the cells of their points."""

    start: Array
    direction: Array
    place: Array  # (n, 2) mm, on the face
    column: NDArray[np.int64]
    row: NDArray[np.int64]
    centre: Array  # (n, 2) mm


def rays(scene: lf.Scene, steepest: float, count: int = RAYS, seed: int = 1) -> Rays:
    """Return rays to random points of an array, from close before it."""
    mla = scene.camera.mla
    assert mla is not None
    lattice = Lattice(mla.layout == "hexagonal", PITCH, *mla.count)
    draw = np.random.default_rng(seed)
    half = np.array(lattice.half_extent)
    place = draw.uniform(-half, half, (4 * count, 2))
    centres = lattice.centres()
    nearest = np.argmin(((place[:, None] - centres.reshape(-1, 2)) ** 2).sum(axis=2), axis=1)
    centre = centres.reshape(-1, 2)[nearest]
    # Only points in cells of the array, which ends in a zigzag if these are hexagons.
    inside = half_width(lattice.hexagonal, place - centre) < 0.5 * PITCH
    place, centre, nearest = (each[inside][:count] for each in (place, centre, nearest))
    sine, turn = steepest * np.sqrt(draw.uniform(size=len(place))), draw.uniform(0.0, 2.0 * np.pi, len(place))
    direction = np.column_stack([sine * np.cos(turn), sine * np.sin(turn), np.sqrt(1.0 - sine**2)])
    front = np.column_stack([place, np.full(len(place), LENS_END + BEFORE)])
    return Rays(front - 0.5 * direction, direction, place, nearest % mla.count[0], nearest // mla.count[0], centre)


def normals(hexagonal: bool) -> Array:
    """Return the directions across the walls of a cell, without their opposites."""
    turn = np.deg2rad([0.0, 60.0, 120.0] if hexagonal else [0.0, 90.0])
    return np.column_stack([np.cos(turn), np.sin(turn)])


def half_width(hexagonal: bool, p: Array) -> Array:
    """Return half the width of the cell about the origin that has a point on its wall."""
    return np.asarray(np.abs(p @ normals(hexagonal).T).max(axis=1))


class Truth(NamedTuple):
    """Rays behind a rod: the largest half width of a cell that they reach, and for rays that pass their ends."""

    widest: Array
    place: Array  # (n, 2) mm, on the sensor
    direction: Array
    weight: Array


def passed(n_i: Array | float, n_t: Array | float, momentum: Array) -> Array:
    """Return Fresnel's transmittance of unpolarised light by its momentum along a plane face."""
    a, b = np.sqrt(np.square(n_i) - momentum**2), np.sqrt(np.square(n_t) - momentum**2)
    s, p = (a - b) / (a + b), (np.square(n_t) * a - np.square(n_i) * b) / (np.square(n_t) * a + np.square(n_i) * b)
    return np.asarray(1.0 - 0.5 * (s**2 + p**2))


def through_rods(of: Rays, hexagonal: bool, axis: Array | float = 0.0) -> Truth:
    """Return rays behind plane rods with their axes at a distance from the centres of their cells."""
    at, p = of.place - of.centre - axis, of.direction[:, :2]
    n1 = N0 * np.sqrt(1.0 - G**2 * (at**2).sum(axis=1))
    tz = np.sqrt(n1**2 - (p**2).sum(axis=1))
    omega = N0 * G
    angle = (omega * LENGTH / tz)[:, None]
    end, momentum = at * np.cos(angle) + p * np.sin(angle) / omega, p * np.cos(angle) - omega * at * np.sin(angle)
    across = normals(hexagonal)
    widest = np.zeros(len(at))
    for n in (*across, *-across):
        a, b = at @ n, p @ n / omega
        first, whole = np.arctan2(b, a) % (2.0 * np.pi), np.hypot(a, b)
        most = np.where(first <= angle[:, 0], whole, np.maximum(a, end @ n))
        widest = np.maximum(widest, most + np.broadcast_to(axis, at.shape) @ n)
    n2 = np.sqrt(tz**2 + (momentum**2).sum(axis=1))
    sine = np.sqrt((momentum**2).sum(axis=1))
    with np.errstate(invalid="ignore"):
        dz = np.sqrt(1.0 - sine**2)
        weight = passed(1.0, n1, np.sqrt((p**2).sum(axis=1))) * passed(n2, 1.0, sine)
        place = end + axis + of.centre + TO_SENSOR * momentum / dz[:, None]
    return Truth(widest, place, np.column_stack([momentum, dz]), weight)


def traced(scene: lf.Scene, of: Rays, **settings: Any) -> lf.Paths:
    return lf.trace(lf.build(scene), of.start, of.direction, **{"split": "transmit"} | settings)


@pytest.mark.parametrize("layout", ["square", "hexagonal"])
def test_rods_take_rays_where_closed_forms_do_and_walls_absorb_the_others(layout: str) -> None:
    scene, hexagonal = camera(layout=layout), layout == "hexagonal"
    of = rays(scene, 0.4)
    truth = through_rods(of, hexagonal)
    assert np.abs(truth.widest - 0.5 * PITCH).min() > 1e-6, "no ray grazes a wall within the tracer's error"
    stays = truth.widest < 0.5 * PITCH
    assert 50 < stays.sum() < RAYS - 50
    paths = traced(scene, of)
    assert np.array_equal(paths.source, np.arange(RAYS))
    ends = np.array(paths.body, dtype=object)
    assert set(ends[stays]) == {"sensor"}
    assert set(ends[~stays]) == {"mla wall", "mla edge"}
    assert np.abs(paths.position[stays, :2] - truth.place[stays]).max() < TRACED_MM
    assert np.abs(paths.direction[stays] - truth.direction[stays]).max() < TRACED_MM
    assert paths.weight[stays] == pytest.approx(truth.weight[stays], rel=1e-9)


@pytest.mark.parametrize("layout", ["square", "hexagonal"])
def test_rays_end_on_the_wall_that_their_curve_reaches_first(layout: str) -> None:
    """Points where rays are absorbed lie on the border of the cell that they entered."""
    scene, hexagonal = camera(layout=layout), layout == "hexagonal"
    of = rays(scene, 0.6)
    paths = traced(scene, of)
    on_wall = np.array([body in ("mla wall", "mla edge") for body in paths.body])
    assert on_wall.sum() > 100
    at = half_width(hexagonal, (paths.position[:, :2] - of.centre)[on_wall])
    assert at == pytest.approx(0.5 * PITCH, abs=1e-14)
    depth = paths.position[on_wall, 2] - LENS_END - BEFORE
    assert ((depth > 0.0) & (depth < LENGTH)).all()


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"layout": "hexagonal", "form": {"decenter_mm": 0.02, "seed": 3}},
        {"radius_mm": [3.0], "curved_side": "sensor", "clear_diameter_mm": 0.9},
        {"radius_mm": [2.0, -4.0], "conic": [-1.0], "back": {"radius_mm": 2.5}},
        {"walls": "clear", "layout": "hexagonal"},
        {"pose": {"tilt_deg": [1.0, -2.0, 5.0], "shift_mm": [0.1, 0.2, 0.0]}},
    ],
)
def test_packets_and_blocks_take_the_same_way(keys: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    scene = camera(**keys)
    of = rays(scene, 0.5)
    blocks = traced(scene, of, engine="sequential")
    with monkeypatch.context() as patch:
        patch.setattr(trace_module, "_in_blocks", trace_module._as_packets)
        in_order = traced(scene, of, engine="sequential")
    singly = traced(scene, of)
    assert (blocks.status == lf.Status.SENSOR).sum() > 50
    for other in (in_order, singly):
        order = np.argsort(other.source, kind="stable")
        kept = np.isin(other.source[order], blocks.source)
        assert np.array_equal(blocks.source, other.source[order][kept])
        assert np.abs(blocks.position - other.position[order][kept]).max() < 10.0 * ROUNDING
        assert np.abs(blocks.direction - other.direction[order][kept]).max() < ROUNDING
        assert np.abs(blocks.weight - other.weight[order][kept]).max() < ROUNDING
        assert blocks.body == [body for body, keep in zip(np.array(other.body)[order], kept, strict=True) if keep]


@pytest.mark.parametrize(
    "shape",
    [
        {},
        {"layout": "hexagonal", "radius_mm": [3.0], "curved_side": "lens"},
        {"radius_mm": [4.0], "curved_side": "sensor", "form": {"decenter_mm": 0.03, "seed": 2}},
        {"radius_mm": [3.0], "conic": [-0.7], "asphere_mm": [[1e-3]], "back": {"radius_mm": 5.0}},
    ],
)
def test_without_coefficients_cells_are_those_of_a_homogeneous_plate(shape: dict[str, Any]) -> None:
    """For light that stays in its cell; all other light ends at a wall."""
    rods, plate = camera(gradient=FLAT, **shape), camera(gradient=None, index=N0, **{"radius_mm": [1e9]} | shape)
    of = rays(rods, 0.15)
    one, other = traced(rods, of), traced(plate, of, record=True)
    at_wall = np.isin(np.array(one.body, dtype=object), ["mla wall", "mla edge"])
    assert 40 < at_wall.sum() < RAYS - 40
    hexagonal = rods.camera.mla is not None and rods.camera.mla.layout == "hexagonal"
    widths: list[list[float]] = [[], []]
    for k in range(RAYS):
        met = np.array([vertex.position[:2] for vertex in other.vertices(k) if vertex.surface.startswith("mla")])
        own = half_width(hexagonal, met - of.centre[k])
        widths[0].append(own[0])
        widths[1].append(own.max())
    first, widest = np.array(widths)
    # A curved face stands back from the plane of its apex, so that some rays meet the neighbour's.
    enters = first < 0.5 * PITCH
    assert enters.sum() > 0.9 * RAYS
    assert np.array_equal(at_wall[enters], widest[enters] >= 0.5 * PITCH * (1.0 - ROUNDING))
    kept = ~at_wall & enters
    off = 1e-8 if not shape else 1e-9  # mm; the plate without a radius has one of a million kilometres
    assert np.abs(one.position[kept] - other.position[kept]).max() < off
    assert one.weight[kept] == pytest.approx(other.weight[kept], rel=1e-8)


def test_clear_walls_without_coefficients_are_those_of_a_homogeneous_plate_for_all_light() -> None:
    shape = {"radius_mm": [3.0], "layout": "hexagonal"}
    rods, plate = camera(gradient=FLAT, walls="clear", **shape), camera(gradient=None, index=N0, **shape)
    of = rays(rods, 0.5)
    one, other = traced(rods, of), traced(plate, of)
    assert np.array_equal(one.source, other.source)
    arrives = (one.status == lf.Status.SENSOR) & (other.status == lf.Status.SENSOR)
    assert arrives.sum() > 200
    assert np.array_equal(one.status, other.status)
    assert np.abs(one.position[arrives] - other.position[arrives]).max() < 1e-9
    assert one.weight[arrives] == pytest.approx(other.weight[arrives], rel=1e-9)


def test_errors_of_centres_move_the_axes_of_the_rods() -> None:
    scene = camera(form={"decenter_mm": 0.05, "seed": 7})
    of = rays(scene, 0.15)
    world = lf.build(scene)
    axes = world.tables.mla.gradient.axes[of.row * 7 + of.column]
    assert 0.02 < np.abs(axes).max() < 0.3
    truth = through_rods(of, False, axes)
    stays = truth.widest < 0.5 * PITCH - 1e-6
    paths = lf.trace(world, of.start, of.direction, split="transmit")
    assert stays.sum() > 100
    assert np.abs(paths.position[stays, :2] - truth.place[stays]).max() < TRACED_MM


def test_axes_are_those_of_a_plate_that_changes_along_z_alone() -> None:
    """Of an axial gradient the momentum across is constant: x grows by p ∫ dz / √(n² − p²)."""
    scene = camera(gradient={"kind": "axial", "index": 1.7, "coefficients": [-0.03, 0.002]}, pitch_mm=PITCH)
    of = rays(scene, 0.1)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    z = 0.5 * LENGTH * (nodes + 1.0)
    index = 1.7 - 0.03 * z + 0.002 * z**2
    p = of.direction[:, :2]
    sine2 = (p**2).sum(axis=1)
    inside = (0.5 * LENGTH * weights / np.sqrt(index**2 - sine2[:, None])).sum(axis=1)
    end = of.place + p * inside[:, None]
    stays = half_width(False, end - of.centre) < 0.5 * PITCH
    place = end + TO_SENSOR * p / np.sqrt(1.0 - sine2)[:, None]
    paths = traced(scene, of)
    assert 100 < stays.sum() < RAYS
    assert set(np.array(paths.body, dtype=object)[~stays]) <= {"mla wall", "mla edge"}
    assert np.abs(paths.position[stays, :2] - place[stays]).max() < TRACED_MM


def test_rods_form_one_upright_image_of_the_same_size() -> None:
    """Rays from a point through several rods meet where the point is, to the aberrations of cones this narrow."""
    scene = lf.load(asset_path("scenes/grin_rods.toml"))
    draw = np.random.default_rng(5)
    world = lf.build(scene)
    for x, y in ((0.0, 0.0), (1.17, -0.43), (-3.1, 2.2)):
        slope = 0.17 * np.sqrt(draw.uniform(size=4000)), draw.uniform(0.0, 2.0 * np.pi, 4000)
        d = np.column_stack([slope[0] * np.cos(slope[1]), slope[0] * np.sin(slope[1]), np.ones(4000)])
        start = np.tile([x, y, -0.1], (4000, 1)) + 1e-3 * d
        paths = lf.trace(world, start, d, split="transmit")
        arrives = paths.status == lf.Status.SENSOR
        image = paths.position[arrives, :2]
        # Each ray crosses the array some 2.35 mm behind the window: which rod is told by its slope.
        through = (start[paths.source] + 3.7 * d[paths.source])[arrives, :2]
        rods = len(np.unique(np.round(through / 0.6), axis=0))
        assert arrives.sum() > 800
        assert rods >= 4
        assert np.abs(np.median(image, axis=0) - [x, y]).max() < 0.01
        assert np.sqrt(((image - [x, y]) ** 2).sum(axis=1).mean()) < 0.05


def glowing(method: str, split: str, **mla: Any) -> lf.Scene:
    """Return short rods, which pass enough light for a quick proof of the aim, behind a window no larger than it."""
    plane = {"shape": {"kind": "plane", "width_mm": 6.0, "height_mm": 6.0}, "position_mm": [0.4, 0.2, -1.0],
             "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    transport = {"method": method, "split": split, "samples": 64, "replicates": 16, "weight_cutoff": 0.5}
    made = camera(thickness_mm=3.0, **mla).camera.model_dump()
    for surface in made["lens"]["surfaces"]:
        surface["semi_diameter_mm"] = 7.0
    made["sensor"] |= {"pixels": [16, 16], "pixel_mm": 0.4}
    return lf.Scene(camera=made, targets=[plane], transport=transport)


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("split", ["transmit", "both"])
def test_energy_closes(method: str, split: str) -> None:
    image = unchecked(glowing(method, split, layout="hexagonal"))
    assert abs(image.ledger.imbalance) <= ROUNDING
    assert image.ledger.lost_share < 1e-7
    assert image.ledger.absorbed["mla wall"] > 0.0


@pytest.mark.parametrize(
    ("split", "keys"),
    [
        ("transmit", {}),
        ("both", {"layout": "hexagonal"}),
        ("transmit", {"radius_mm": [3.0], "walls": "clear"}),
    ],
)
def test_forward_equals_adjoint(split: str, keys: dict[str, Any]) -> None:
    """Power sums of the whole image and of its quarters, by Welch's z at LEVEL for all comparisons of a case."""
    sums, errors = [], []
    for method, samples in (("adjoint", 16384), ("forward", 262144)):
        quarters = {"camera.sensor.pixels": [2, 2], "camera.sensor.pixel_mm": 3.2, "transport.samples": samples}
        image = unchecked(glowing(method, split, **keys).changed(quarters))
        blocks, error = image.mean[:, :, 0].ravel(), image.stderr[:, :, 0].ravel()
        sums.append(np.append(blocks, blocks.sum()))
        errors.append(np.append(error, np.sqrt(np.square(error).sum())))
    assert np.hypot(*errors)[-1] < 0.02 * sums[0][-1]
    z = np.abs(sums[0] - sums[1]) / np.hypot(*errors)
    assert (z < stats.t.ppf(1.0 - LEVEL / (2 * len(z)), 15)).all(), z


@pytest.mark.parametrize("keys", [{"layout": "hexagonal"}, {"radius_mm": [3.0], "walls": "clear"}])
def test_aimed_rays_find_all_light(keys: dict[str, Any]) -> None:
    """Rays that go anywhere, which every render sends too, find no light that the aimed ones miss."""
    blind = lf.render(glowing("adjoint", "transmit", **keys)).blind
    assert blind is not None
    assert blind.agrees


@pytest.mark.parametrize(
    ("keys", "field"),
    [
        ({"walls": "clear", "form": {"decenter_mm": 0.01}}, "walls"),
        ({"walls": "clear", "radius_mm": [3.0, 4.0]}, "walls"),
        ({"walls": "clear", "gradient": {"kind": "xyz", "index": 1.6, "x_coefficients": [0.01]}}, "walls"),
        ({"radius_mm": [3.0], "back": {"radius_mm": 3.0, "decenter_mm": [0.1, 0.0]}}, "decenter_mm"),
    ],
)
def test_cells_with_different_glass_at_their_wall_are_refused(keys: dict[str, Any], field: str) -> None:
    with pytest.raises(SceneError, match=field):
        camera(**keys)


def test_settings_that_gradient_lenslets_do_not_have_are_refused() -> None:
    scene = camera()
    for key, value in (
        ("transport.engine", "mesh"),
        ("transport.polarisation", True),
        ("transport.surface", "flat"),
        ("transport.diffraction", "lenslets"),
    ):
        with pytest.raises(SceneError, match="gradient"):
            engine_of(scene.changed({key: value}))


def test_an_index_that_is_not_real_in_a_cell_is_refused() -> None:
    steep = {"kind": "radial_n2", "index": 1.6, "coefficients": [-2.5]}
    with pytest.raises(SceneError, match=r"camera\.mla\.gradient: .*n² = -0\.64 at 0\.7071 mm .* must lie between"):
        lf.build(camera(gradient=steep))


def test_gradient_lenslets_are_not_decoded() -> None:
    with pytest.raises(LfmeshError, match=r"camera\.mla\.gradient"):
        lf.camera_model(camera())


def test_a_homogeneous_array_has_no_table_of_gradients() -> None:
    world = lf.build(camera(gradient=None, index=1.6, radius_mm=[3.0]))
    assert world.tables.mla.gradient is None
    assert world.tables.mla.back is None
