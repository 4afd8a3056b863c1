"""A phase sends light into its orders: their directions, their shares for light and for importance, and their book."""

from collections import Counter
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.transport.choice import engine_of
from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.events.phase import EVANESCENT, light_at_phase, towards_order
from lfmesh.transport.packets.book import Book
from lfmesh.transport.packets.packet import BY_MESH
from lfmesh.transport.ray_starts import located
from lfmesh.transport.settings import SPLIT_MODE, options_of
from lfmesh.transport.sources.rays import RaySource
from lfmesh.transport.sources.source import Launcher
from lfmesh.transport.tables.interfaces import coatings_in_book, interface_tables
from lfmesh.transport.tables.phase_faces import END_OF_ORDERS, FIRST_REFLECTED, FIRST_TRANSMITTED, PhaseFaces
from lfmesh.transport.tables.tables import Interfaces
from lfmesh.transport.trace import at_wavelength
from tests.renders import unchecked

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds."""

NM = 587.6
MM = NM * 1e-6
CLOSED = 1e-12
"""Of the emitted power: rounding."""

SUN = [{"index": 1.46, "thickness_nm": 60.0}, {"index": 1.8, "extinction": 0.4, "thickness_nm": 45.0}]
COATINGS = {"hard": {"layers": [{"index": 1.38, "thickness_nm": 106.5}]}, "sun": {"layers": SUN}}

SHARES = [{"order": -1, "share": 0.2}, {"order": 0, "share": 0.1}, {"order": 1, "share": 0.5}]
THROWN = [{"order": 0, "share": 0.6}, {"order": 1, "share": 0.3}]


def grating(change: float, **keys: Any) -> dict[str, Any]:
    """Return a grating that changes the momentum along x by this in the first order."""
    return {"kind": "grating", "lines_per_mm": change / MM} | keys


def window(front: dict[str, Any], index: float = 1.5, semi_diameter_mm: float = 30.0) -> list[dict[str, Any]]:
    """Return a plane plate of 2 mm, with a stop of 2 mm in diameter 1 mm behind it."""
    return [
        {"thickness_mm": 2.0, "index": index, "semi_diameter_mm": semi_diameter_mm} | front,
        {"thickness_mm": 1.0, "semi_diameter_mm": semi_diameter_mm},
        {"stop": True, "semi_diameter_mm": 1.0},
    ]


def scene(lens: list[dict[str, Any]], mla: dict[str, Any] | None = None, **transport: Any) -> lf.Scene:
    """Return a camera with this lens, and a sensor 10 mm behind it or 0.5 mm behind an array."""
    camera: dict[str, Any] = {
        "lens": {"surfaces": lens},
        "sensor": {"pixels": [40, 40], "pixel_mm": 0.5, "distance_mm": 0.5 if mla else 10.0},
    }
    if mla is not None:
        camera["mla"] = mla
    return lf.Scene(camera=camera, coatings=COATINGS, transport={"wavelengths_nm": [NM]} | transport)


def transmittance(n_i: float, n_t: float, momentum: Array | float) -> Array:
    """Fresnel's transmittance of unpolarised light by its momentum along the face; 0 under total reflection."""
    p = np.abs(np.asarray(momentum, np.float64))
    passes = (p < n_i) & (p < n_t)
    s = np.where(passes, p, 0.0)
    a, b = np.sqrt(n_i**2 - s**2), np.sqrt(n_t**2 - s**2)
    across, along = (a - b) / (a + b), (n_t**2 * a - n_i**2 * b) / (n_t**2 * a + n_i**2 * b)
    return np.where(passes, 1.0 - 0.5 * (across**2 + along**2), 0.0)


class Face:
    """The first surface of a lens with a phase."""

    def __init__(self, **surface: Any) -> None:
        self.index = surface.pop("index", 1.5)
        made = scene(window(surface, index=self.index))
        self.interfaces: Interfaces = interface_tables(made, (NM,)).lens
        phases = self.interfaces.phases
        assert phases is not None
        self.phases: PhaseFaces = phases

    def orders(self, *, reflected: bool) -> range:
        """Numbers of the listed orders in the tables."""
        first = self.phases.first[0]
        return range(first[FIRST_REFLECTED], first[END_OF_ORDERS]) if reflected else range(
            first[FIRST_TRANSMITTED], first[FIRST_REFLECTED]
        )  # fmt: skip

    def goes(
        self, listed: int, d: Array, n: Array, place: tuple[float, float], *, into: bool, importance: bool = False
    ) -> tuple[float, Array]:
        """Return share and direction of an order, for a ray from the air (`into`) or from the glass."""
        phases = self.phases._replace(against_light=importance)
        interfaces = self.interfaces._replace(phases=phases)
        indices = (1.0, self.index) if into else (self.index, 1.0)
        light = light_at_phase(interfaces, phases, 0, 0, indices, tuple(d), tuple(n), place, not into)
        reflects = listed >= phases.first[0, FIRST_REFLECTED]
        share, _, *out = towards_order(interfaces, phases, light, listed, reflects)
        return share, np.array(out)


def unit(*v: float) -> Array:
    return np.array(v) / np.linalg.norm(v)


def test_an_order_adds_its_gradient_to_the_momentum_along_the_face() -> None:
    """n sin θ changes by m λ ∇Φ/2π along the face, for every order, also on an inclined face."""
    face = Face(phase={"kind": "radial", "coefficients_rad": [-900.0, 40.0], "radius_mm": 9.0, "orders": SHARES})
    draw = np.random.default_rng(1)
    checked = 0
    for _ in range(200):
        n, d = unit(*draw.normal(0.0, 0.3, 2), 1.0), unit(*draw.normal(0.0, 0.5, 2), 1.0)
        x, y = draw.uniform(-9.0, 9.0, 2)
        u = (x * x + y * y) / 81.0
        gradient = np.array([x, y, 0.0]) * 2.0 * (-900.0 + 2.0 * 40.0 * u) / 81.0
        for listed in face.orders(reflected=False):
            m = face.phases.order[listed]
            share, out = face.goes(listed, d, n, (x, y), into=True)
            expected = d + m * MM / (2.0 * np.pi) * gradient
            expected -= (expected @ n) * n
            if np.linalg.norm(expected) >= 1.5:
                assert share == EVANESCENT
                continue
            np.testing.assert_allclose(1.5 * (out - (out @ n) * n), expected, atol=1e-14)
            assert out @ n > 0.0
            assert np.linalg.norm(out) == pytest.approx(1.0, abs=1e-14)
            checked += 1
    assert checked > 400


def test_importance_takes_the_transmittance_of_the_light_that_it_stands_for() -> None:
    """With n 1.5, p 0.3 and G 0.6, light that comes back arrives at 0.9: 0.886 passes, not the 0.960 at 0.3."""
    face = Face(phase=grating(0.6))
    (first,) = face.orders(reflected=False)
    d, n = np.array([0.3, 0.0, np.sqrt(1.0 - 0.09)]), np.array([0.0, 0.0, 1.0])
    flux, out = face.goes(first, d, n, (0.0, 0.0), into=True)
    weight, same = face.goes(first, d, n, (0.0, 0.0), into=True, importance=True)
    np.testing.assert_array_equal(out, same)
    assert 1.5 * out[0] == pytest.approx(0.9, abs=1e-14)
    assert flux == pytest.approx(0.960, abs=5e-4)
    assert weight == pytest.approx(0.886, abs=5e-4)
    assert flux == pytest.approx(float(transmittance(1.0, 1.5, 0.3)), abs=1e-14)
    assert weight == pytest.approx(float(transmittance(1.5, 1.0, 0.9)), abs=1e-14)


@pytest.mark.parametrize("coating", ["none", "hard", "sun"])
def test_importance_is_the_light_of_the_reversed_ray(coating: str) -> None:
    """Of every order, transmitted and reflected, from both sides, also where one way is reflected totally."""
    face = Face(phase=grating(0.8, orders=SHARES, reflected_orders=THROWN, direction_deg=25.0), coating=coating)
    draw = np.random.default_rng(2)
    found: Counter[tuple[bool, bool, bool]] = Counter()
    for _ in range(300):
        n, d = unit(*draw.normal(0.0, 0.2, 2), 1.0), unit(*draw.normal(0.0, 1.0, 2), 1.0)
        into = bool(draw.random() < 0.5)
        if d @ n <= 0.0:
            continue
        for reflected in (False, True):
            for listed in face.orders(reflected=reflected):
                weight, out = face.goes(listed, d, n, (0.0, 0.0), into=into, importance=True)
                if weight == EVANESCENT:
                    continue
                back = n if reflected else -n
                flux, home = face.goes(listed, -out, back, (0.0, 0.0), into=into == reflected)
                np.testing.assert_allclose(home, -d, atol=1e-12)
                assert flux == pytest.approx(weight, abs=1e-12)
                found[into, reflected, weight == 0.0] += 1
    assert {(into, reflected) for into, reflected, _ in found} == {(i, r) for i in (False, True) for r in (False, True)}
    assert found[True, False, True] > 0, "light from the glass that the face reflects totally"


def test_the_zeroth_order_reflects_by_the_angle_of_incidence_either_way() -> None:
    face = Face(phase=grating(0.5))
    (zeroth,) = face.orders(reflected=True)
    d, n = unit(0.4, 0.1, 1.0), np.array([0.0, 0.0, 1.0])
    for importance in (False, True):
        share, out = face.goes(zeroth, d, n, (0.0, 0.0), into=True, importance=importance)
        assert share == pytest.approx(1.0 - float(transmittance(1.0, 1.5, np.hypot(d[0], d[1]))), abs=1e-14)
        np.testing.assert_allclose(out, d * [1.0, 1.0, -1.0], atol=1e-15)


def test_the_light_of_a_ray_is_divided_among_its_orders_and_the_book() -> None:
    """A ray on a grating before a plate: angle, weight and number of its orders behind it, by hand."""
    world = lf.build(scene(window({"phase": grating(0.45, orders=SHARES)})), aimed=False)
    p = 0.2
    paths = lf.trace(world, [[0.0, 0.0, -1.0]], [[p, 0.0, np.sqrt(1.0 - p * p)]], weight_cutoff=0.0, max_events=2)
    # Both faces, without a reflection.
    straight = (paths.events == 2) & (paths.direction[:, 2] > 0.0) & np.isin(paths.body, ["sensor", "stop", "mount"])
    first = float(transmittance(1.0, 1.5, p))
    expected = {
        p + 0.45 * m: first * share * float(transmittance(1.5, 1.0, p + 0.45 * m))
        for m, share in ((-1, 0.2), (0, 0.1), (1, 0.5))
    }
    order = np.argsort(paths.direction[straight, 0])
    np.testing.assert_allclose(paths.direction[straight, 0][order], sorted(expected), atol=1e-14)
    np.testing.assert_allclose(paths.weight[straight][order], [expected[q] for q in sorted(expected)], rtol=1e-12)
    assert paths.ledger.absorbed["unlisted orders of lens surface 0"] == pytest.approx(first * 0.2, rel=1e-12)
    assert "evanescent orders of lens surface 0" not in paths.ledger.absorbed
    assert abs(paths.ledger.imbalance) < CLOSED


@pytest.mark.parametrize("split", ["both", "roulette", "transmit"])
def test_an_order_without_a_direction_ends_at_the_face(split: str) -> None:
    """At 0.4, G = 1.2 leads beyond 1.5 in the first order; the others propagate."""
    world = lf.build(scene(window({"phase": grating(1.2, orders=SHARES)})), aimed=False)
    direction = [0.4, 0.0, np.sqrt(1.0 - 0.16)]
    paths = lf.trace(world, [[0.0, 0.0, -1.0]], [direction], split=split, weight_cutoff=0.0, max_events=1)
    lost = paths.ledger.absorbed["evanescent orders of lens surface 0"]
    assert lost == pytest.approx(0.5 * float(transmittance(1.0, 1.5, 0.4)), rel=1e-12)
    assert abs(paths.ledger.imbalance) < CLOSED


@pytest.mark.parametrize("backwards", [False, True])
def test_both_engines_book_an_evanescent_order_alike(backwards: bool) -> None:
    """Its only order, so that the ray ends there; from behind, on its way out."""
    world = lf.build(scene(window({"phase": grating(1.2)})), aimed=False)
    draw = np.random.default_rng(5)
    p = draw.uniform(-0.9, 0.9, (400, 2)) * [1.0, 0.2]
    directions = np.column_stack([p, np.sqrt(1.0 - (p**2).sum(axis=1))])
    origins = np.tile([0.0, 0.0, -1.0], (400, 1))
    if backwards:
        origins, directions = np.tile([0.0, 0.0, 4.0], (400, 1)), -directions
    ledgers = [
        lf.trace(world, origins, directions, split="transmit", engine=engine).ledger
        for engine in ("mesh", "sequential")
    ]
    name = "evanescent orders of lens surface 0"
    assert ledgers[0].absorbed[name] > 20.0
    assert ledgers[0].absorbed[name] == pytest.approx(ledgers[1].absorbed[name], rel=1e-12)
    assert max(abs(ledger.imbalance) for ledger in ledgers) < CLOSED


@pytest.mark.parametrize("importance", [False, True])
@pytest.mark.parametrize("split", ["both", "roulette", "transmit"])
def test_roulette_among_orders_is_unbiased(split: str, importance: bool) -> None:
    """The mean weight that comes through both faces in each order, by z-tests with Bonferroni's correction."""
    world = lf.build(scene(window({"phase": grating(0.45, orders=SHARES, reflected_orders=THROWN)})), aimed=False)
    tables, p, count = at_wavelength(world, NM), 0.2, 1 << 14
    options = options_of(
        world, tracing=True, faces=BY_MESH, split=SPLIT_MODE[split], cutoff=1.0, importance=importance
    )  # fmt: skip
    origins, directions = np.tile([0.0, 0.0, -1.0], (count, 1)), np.tile([p, 0.0, np.sqrt(1.0 - p * p)], (count, 1))
    station, space, origins, directions = located(world, origins, directions)
    source = RaySource(origins, directions, station, space, np.ones(count), np.uint64(7))
    launcher = Launcher(lambda: Workspace(world, options, tables=tables))
    parts = launcher.traced(source, lambda work, _: (work.ends(), work.book.copy()), 1, CHUNK)
    ends = np.concatenate([part[0] for part in parts])
    ledger = world.book.ledger(np.sum([part[1] for part in parts], axis=0), "")
    assert abs(ledger.imbalance) < CLOSED
    p_values = []
    for m, share in ((-1, 0.2), (0, 0.1), (1, 0.5)):
        q = p + 0.45 * m
        through = (ends["events"] == 2) & (ends["direction"][:, 2] > 0.0) & (abs(ends["direction"][:, 0] - q) < 1e-9)
        weights = np.bincount(ends["source"][through], ends["weight"][through], count)
        at_first = transmittance(1.5, 1.0, q) if importance else transmittance(1.0, 1.5, p)
        expected = share * float(at_first * transmittance(1.5, 1.0, q))
        assert weights.std() > 0.0
        p_values.append(stats.ttest_1samp(weights, expected).pvalue)
    assert min(p_values) > LEVEL / len(p_values) / 6


def test_without_phases_a_region_has_no_table_and_the_book_no_slot() -> None:
    plain = scene(window({}))
    assert all(each.phases is None for each in interface_tables(plain, (NM,)))
    assert coatings_in_book(plain) == []
    given = scene(window({"phase": grating(0.1)}))
    tables = interface_tables(given, (NM,))
    assert tables.lens.phases is not None
    assert tables.mla.phases is None
    names = ["evanescent orders of lens surface 0", "unlisted orders of lens surface 0"]
    assert coatings_in_book(given) == names
    book = Book.of_bodies(1, [], [], names)
    slots = interface_tables(given, (NM,), book)[0].phases.slot
    assert [book.slots[slot].name for slot in slots[0]] == names


MLA: dict[str, Any] = {
    "count": [20, 20], "pitch_mm": 0.5, "focal_length_mm": 1.5, "index": 1.5, "thickness_mm": 0.5, "distance_mm": 10.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("lens", "mla", "words"),
    [
        (window({"phase": grating(0.1, orders=SHARES)}), None, r"camera\.lens\.surfaces\[0\] has a phase with several"),
        (window({"phase": grating(0.1, reflected_orders=THROWN)}), None, "several orders"),
        (window({}), MLA | {"flat_phase": grating(0.1, orders=SHARES)}, r"camera\.mla, its flat face has a phase"),
    ],
)
def test_the_sequential_engine_refuses_several_orders_and_auto_takes_the_meshes(
    lens: list[dict[str, Any]], mla: dict[str, Any] | None, words: str
) -> None:
    given = scene(lens, mla)
    assert engine_of(given)[0] == "mesh"
    with pytest.raises(SceneError, match=words):
        engine_of(given.changed({"transport.engine": "sequential"}))
    world = lf.build(given, aimed=False)
    with pytest.raises(lf.LfmeshError, match="several orders"):
        lf.trace(world, [[0, 0, -9]], [[0, 0, 1]], split="transmit", engine="sequential")


def test_a_trace_refuses_facets_in_place_of_the_exact_surface_of_a_phase() -> None:
    world = lf.build(scene(window({"phase": grating(0.1)})), aimed=False)
    with pytest.raises(lf.LfmeshError, match="exact"):
        lf.trace(world, [[0, 0, -9]], [[0, 0, 1]], surface="flat")


@pytest.mark.parametrize("key", ["curved_phase", "flat_phase"])
def test_diffraction_at_lenslets_with_a_phase_is_refused(key: str) -> None:
    given = {"camera.mla": MLA | {key: grating(0.05)}, "transport.diffraction": "lenslets"}
    with pytest.raises(SceneError, match=f"lenslets.*camera.mla.{key}"):
        lf.build(scene(window({}), MLA).changed(given))


GLOW = {"reflectance": 0.0, "radiance_w_m2_sr": 1e3}
CROWDED: dict[str, Any] = {
    "camera": {
        "focus_mm": 60.0,
        "lens": {
            "surfaces": [
                {"radius_mm": 25.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 5.0, "coating": "sun",
                 "phase": {"kind": "radial", "coefficients_rad": [-500.0], "radius_mm": 5.0, "orders": SHARES,
                           "reflected_orders": THROWN}},
                {"radius_mm": -25.0, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
                {"stop": True, "semi_diameter_mm": 4.0},
            ]
        },
        "mla": {"count": [4, 4], "pitch_mm": 0.5, "focal_length_mm": 2.6, "index": 1.5, "thickness_mm": 0.5,
                "curved_phase": grating(1.45, orders=SHARES, direction_deg=40.0),
                "flat_phase": grating(0.3, order=-1)},
        "sensor": {"pixels": [20, 20], "pixel_mm": 0.1},
    },
    "targets": [
        {"shape": {"kind": "plane", "width_mm": 20.0, "height_mm": 20.0}, "position_mm": [0, 0, -60.0],
         "material": {"reflectance": 0.8, "radiance_w_m2_sr": 1e3}},
    ],
    "lights": [{"kind": "point", "position_mm": [-20.0, -15.0, -25.0], "power_w": 1.0}],
    "coatings": COATINGS,
    "transport": {"samples": 32, "replicates": 2, "threads": 1, "wavelengths_nm": [450.0, NM]},
}  # fmt: skip


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("split", ["transmit", "both", "roulette"])
def test_energy_closes_with_orders_on_lens_and_array(method: str, split: str) -> None:
    changes = {"transport.method": method, "transport.split": split, "transport.weight_cutoff": 0.6}
    image = unchecked(lf.Scene(**CROWDED).changed(changes))
    ledger = image.ledger
    assert abs(ledger.imbalance) <= CLOSED
    assert ledger.lost_share < 1e-7
    assert image.mean.sum() > 0.0
    assert image.order is None or image.order.holds
    for name in ("lens surface 0", "the mla's curved face"):
        assert ledger.absorbed[f"unlisted orders of {name}"] != 0.0
        if method == "forward":
            assert ledger.absorbed[f"unlisted orders of {name}"] > 0.0
    assert ledger.absorbed["evanescent orders of the mla's curved face"] > 0.0
    assert ledger.absorbed["coating of lens surface 0"] > 0.0
    assert "unlisted orders of the mla's flat face" not in ledger.absorbed or method == "adjoint"


def test_orders_found_by_the_order_of_the_surfaces_are_those_of_the_meshes() -> None:
    image = lf.render(lf.Scene(**CROWDED).changed({"transport.split": "both", "transport.samples": 4}))
    assert image.order is not None
    assert image.order.compared > 100
    assert image.order.holds


ORDERS = [{"order": 2, "share": 0.7}, {"order": 1, "share": 0.2}]
TARGET_MM = -20.0
CASES: dict[str, tuple[dict[str, Any], dict[str, Any] | None, tuple[tuple[float, float], ...]]] = {
    # Phase of the lens; array; changes of momentum of light in its orders, and their shares.
    "on the lens": ({"phase": grating(0.6)}, None, ((0.6, 1.0),)),
    "on the lens, coated": ({"phase": grating(0.6), "coating": "quarter"}, None, ((0.6, 1.0),)),
    "several orders on the lens": ({"phase": grating(0.3, orders=ORDERS)}, None, ((0.6, 0.7), (0.3, 0.2))),
    "on the array, towards the lens": (
        {}, {"curved_side": "lens", "curved_phase": grating(0.6)}, ((0.6, 1.0),)
    ),
    "on the array, towards the sensor": (
        {}, {"curved_side": "sensor", "curved_phase": grating(0.6)}, ((0.6, 1.0),)
    ),
    "on the array's other face": (
        {}, {"curved_side": "lens", "curved_phase": grating(0.1), "flat_phase": grating(0.5)}, ((0.6, 1.0),)
    ),
}  # fmt: skip


def places(name: str) -> tuple[float, tuple[float, float, float]]:
    """Return x of the sensor's middle, and x, width and height of the target, in mm."""
    return (-2.0, (35.0, 40.0, 30.0)) if CASES[name][1] is None else (-12.3, (41.0, 30.0, 16.0))


def steep(name: str, method: str) -> lf.Scene:
    """A glowing plane whose light comes from the side, on a grating that turns it towards a sensor aside."""
    front, array, _ = CASES[name]
    middle, (x, width, height) = places(name)
    # No larger than the light, or most rays would miss it.
    lens = window(front, semi_diameter_mm=7.0) if array is None else [
        {"stop": True, "thickness_mm": 1.0, "semi_diameter_mm": 1.0},
        {"thickness_mm": 0.5, "index": 1.0001, "semi_diameter_mm": 7.0}, {"semi_diameter_mm": 7.0},
    ]  # fmt: skip
    plate = {"count": [60, 6], "pitch_mm": 0.5, "index": 1.5, "thickness_mm": 2.0, "distance_mm": 4.0}
    camera: dict[str, Any] = {
        "lens": {"surfaces": lens},
        "sensor": {"pixels": [4, 4], "pixel_mm": 0.5, "distance_mm": 8.0 if array is None else 2.0,
                   "pose": {"shift_mm": [middle, 0.0, 0.0]}},
    }  # fmt: skip
    if array is not None:
        camera["mla"] = plate | array
    transport = {"method": method, "split": "transmit", "replicates": 16, "wavelengths_nm": [NM]}
    plane = {"kind": "plane", "width_mm": width, "height_mm": height}
    target = {"shape": plane, "position_mm": [x, 0.0, TARGET_MM], "material": GLOW}
    coatings = COATINGS | {"quarter": {"reflectance": 0.25}}
    return lf.Scene(camera=camera, coatings=coatings, transport=transport, targets=[target])


def reaching(name: str, at: Array, p: Array) -> Array:
    """Radiance at a point of the sensor by the optical momentum (n, 2) of light there, over the target's.

    Rays are traced back through plane faces, with the momentum that the grating takes away, to the target.
    """
    _, array, orders = CASES[name]
    _, (target_x, width, height) = places(name)
    found = np.zeros(len(p))
    for change, share in orders:
        if array is None:
            # Sensor, stop, air of 1 mm, plate of 2 mm with the grating in front.
            legs = [(8.0, 1.0, 1.0, 0.0), (1.0, 1.0, 1.5, 0.0), (2.0, 1.5, 1.0, change)]
            stop_after = 1
        else:
            lens_side, sensor_side = change, 0.0
            if array["curved_side"] == "sensor":
                lens_side, sensor_side = 0.0, change
            elif "flat_phase" in array:
                lens_side, sensor_side = 0.1, 0.5
            legs = [(2.0, 1.0, 1.5, sensor_side), (2.0, 1.5, 1.0, lens_side), (5.5, 1.0, 1.0, 0.0)]
            stop_after = 3
        q, x, passed = p.copy(), np.tile(at, (len(p), 1)), np.ones(len(p))
        for number, (length, n, before, g) in enumerate(legs):
            square = n * n - (q**2).sum(axis=1)
            on = square > 0.0
            x = x - np.where(on[:, None], length * q / np.sqrt(np.where(on, square, 1.0))[:, None], 0.0)
            passed = passed * on
            if number + 1 == stop_after:
                passed = passed * ((x**2).sum(axis=1) <= 1.0)
            q = q - [g, 0.0]
            size = np.sqrt((q**2).sum(axis=1))
            if before != n or g != 0.0:
                through = transmittance(before, n, size)
                if "coated" in name and number == 2:
                    through = np.where((size < before) & (size < n), 0.75, 0.0)
                passed = passed * through
        # Air in front of the camera, from its first face or the stop.
        on = passed > 0.0
        slope = q[on] / np.sqrt(1.0 - (q[on] ** 2).sum(axis=1))[:, None]
        off = np.abs(x[on] + TARGET_MM * slope - [target_x, 0.0])
        passed[on] *= (off <= [0.5 * width, 0.5 * height]).all(axis=1)
        found += share * passed
    return found


def irradiance(name: str, at: Array) -> float:
    """Irradiance over the radiance at a point of the sensor: the integral of the transmittance over p_x p_y."""
    step, coarse = 0.0008, 10

    def momenta(spans: Array, step: float) -> Array:
        return np.stack(np.meshgrid(*(np.arange(*span, step) for span in spans)), axis=-1).reshape(-1, 2)

    # A coarse grid finds the few momenta with light: the stop is small.
    p = momenta(np.array([[-0.6, 0.1], [-0.35, 0.35]]), coarse * step)
    lit = p[reaching(name, at, p) > 0.0]
    spans = np.column_stack([lit.min(axis=0) - coarse * step, lit.max(axis=0) + coarse * step])
    return float(reaching(name, at, momenta(spans, step)).sum()) * step**2


@pytest.mark.parametrize("name", CASES)
def test_forward_equals_adjoint_and_the_integral_at_steep_angles(name: str) -> None:
    """Power of the whole image by Welch's test, and by a quadrature with Fresnel's equations.

    Light arrives at momenta of 0.7 to 1: with the transmittance of the wrong side an adjoint image would be several per
    cent brighter.
    """
    # Rays are not aimed through several orders, and few of them through steep ones of lenslets.
    aimed, several = name.startswith("on the lens"), name.startswith("several")
    total, error = [], []
    for method, samples in (("adjoint", 2048 if aimed else 16384), ("forward", 262144 if several else 65536)):
        image = unchecked(steep(name, method).changed({"transport.samples": samples}))
        assert abs(image.ledger.imbalance) < 1e-9
        total.append(float(image.mean.sum()))
        error.append(float(np.sqrt(np.square(image.stderr).sum())))
    assert error[0] < (0.008 if aimed else 0.04) * total[0]
    assert error[1] < (0.02 if several else 0.008) * total[0]
    limit = stats.t.ppf(1.0 - 0.5 * LEVEL / 3 / len(CASES), 15)
    fine = (np.arange(4) - 1.5) * 0.5
    points = [np.array([places(name)[0] + x, y]) for x in fine for y in fine]
    truth = 1e3 * np.mean([irradiance(name, each) for each in points]) * 4e-6
    assert abs(total[0] - total[1]) < limit * np.hypot(*error)
    for sum_, its in zip(total, error, strict=True):
        # The grid is coarse at the edges of stop and target.
        assert abs(sum_ - truth) < limit * its + 4e-3 * truth


FOCUSING: dict[str, dict[str, Any]] = {
    "a radial phase on a lens": {
        "lens": [
            {"radius_mm": 40.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 6.0,
             "phase": {"kind": "radial", "coefficients_rad": [-600.0, 10.0], "radius_mm": 6.0}},
            {"radius_mm": -60.0, "thickness_mm": 1.0, "semi_diameter_mm": 6.0},
            {"stop": True, "semi_diameter_mm": 4.0},
        ],
    },
    "a grating behind the stop": {
        "lens": [
            {"radius_mm": 40.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 6.0},
            {"radius_mm": -60.0, "thickness_mm": 1.0, "semi_diameter_mm": 6.0},
            {"stop": True, "semi_diameter_mm": 3.0, "thickness_mm": 1.0},
            {"thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 6.0, "phase": grating(0.02)},
            {"semi_diameter_mm": 6.0},
        ],
    },
    "an array of metalenses towards the lens": {
        "mla": {"curved_phase": {"kind": "metalens", "focal_length_mm": 2.6, "design_nm": NM}},
    },
    "an array of metalenses towards the sensor": {
        "mla": {"curved_side": "sensor", "curved_phase": {"kind": "metalens", "focal_length_mm": 2.6, "design_nm": NM}},
    },
    "lenslets with a corrector behind": {
        "mla": {"focal_length_mm": 2.6,
                "flat_phase": {"kind": "radial", "coefficients_rad": [-20.0], "radius_mm": 0.25}},
    },
    "decentred metalenses": {
        "mla": {"curved_phase": {"kind": "metalens", "focal_length_mm": 2.6, "design_nm": NM},
                "form": {"decenter_mm": 0.03}},
    },
}  # fmt: skip


@pytest.mark.parametrize("name", FOCUSING)
def test_the_aim_through_phases_holds_all_light(name: str) -> None:
    """Rays from the stop, which see the phases, find what the aim misses: nothing, and no fallback hides it."""
    given = FOCUSING[name]
    plain = [
        {"radius_mm": 20.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 5.0},
        {"radius_mm": -20.0, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
        {"stop": True, "semi_diameter_mm": 4.0},
    ]
    camera: dict[str, Any] = {
        "lens": {"surfaces": given.get("lens", plain)}, "sensor": {"pixels": [20, 20], "pixel_mm": 0.1},
    }  # fmt: skip
    if "mla" in given:
        plate = {"count": [4, 4], "pitch_mm": 0.5, "index": 1.5, "thickness_mm": 0.5, "distance_mm": 22.0}
        camera["mla"] = plate | given["mla"]
        camera["sensor"]["distance_mm"] = 2.2
    else:
        camera["sensor"]["distance_mm"] = 40.0
    plane = {"shape": {"kind": "plane", "width_mm": 40.0, "height_mm": 40.0}, "position_mm": [0, 0, -80.0]}
    made = lf.Scene(camera=camera, targets=[plane], transport={"wavelengths_nm": [486.1, NM, 656.3]})
    proof = lf.build(made).aim_proof
    assert proof is not None
    assert proof.holds, proof
    assert not proof.fallback
