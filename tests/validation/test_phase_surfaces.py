"""Phase surfaces ray by ray: a trace in 30 digits, and closed forms of gratings, metalenses, holograms and blazes.

The truth knows the formulas of the phases and of the sags alone; mpmath differentiates them. Along the face n times the
unit direction changes by mλ/2π times the gradient of the phase (W. T. Welford, Optics Communications 14, 1975, 322).
Light in an order is Fresnel's transmittance of the refracted ray times the share of the order.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from tests.validation.phase_truth import Face, rotation, through_faces

Array = NDArray[np.float64]

ENGINES = ("mesh", "sequential")
NM, DESIGN_NM = 587.6, 550.0
SEMI, THICKNESS, GAP = 4.0, 5.0, 10.0

EXACT = 1e-12
"""Largest error of a position in mm, of a direction and of a weight."""


def waves(nm: float) -> Any:
    """Return 2π over a wavelength, 1/mm."""
    return 2 * mp.pi / (mp.mpf(nm) * mp.mpf("1e-6"))


def radial(x: Any, y: Any) -> Any:
    u = (x * x + y * y) / 25
    return -300 * u + 40 * u**2 - 7 * u**3


def xy(x: Any, y: Any) -> Any:
    u, v = x / 5, y / 5
    return 200 * u - 150 * u * u + 90 * u * v + 60 * v**3 - 25 * u * v**2


def grating(x: Any, y: Any) -> Any:
    turn = mp.mpf(35) * mp.pi / 180
    return 2 * mp.pi * 120 * (x * mp.cos(turn) + y * mp.sin(turn))


def metalens(x: Any, y: Any) -> Any:
    return -waves(DESIGN_NM) * (mp.sqrt(x * x + y * y + 30**2) - 30)


def diverging(x: Any, y: Any) -> Any:
    return waves(DESIGN_NM) * (mp.sqrt(x * x + y * y + 45**2) - 45)


def hologram(x: Any, y: Any) -> Any:
    first = mp.sqrt((x - 2) ** 2 + (y + 1) ** 2 + 60**2)
    second = mp.sqrt((x + 1) ** 2 + (y - 3) ** 2 + 45**2)
    return waves(DESIGN_NM) * (-second - first)


Keys = dict[str, Any]
Phase = Callable[[Any, Any], Any]

PHASES: dict[str, tuple[Keys, Phase]] = {
    "radial": ({"kind": "radial", "coefficients_rad": [-300.0, 40.0, -7.0], "radius_mm": 5.0, "order": 2}, radial),
    "xy": (
        {
            "kind": "xy",
            "coefficients_rad": [[1, 0, 200.0], [2, 0, -150.0], [1, 1, 90.0], [0, 3, 60.0], [1, 2, -25.0]],
            "radius_mm": 5.0,
        },
        xy,
    ),
    "grating": ({"kind": "grating", "lines_per_mm": 120.0, "direction_deg": 35.0, "order": -2}, grating),
    "metalens": ({"kind": "metalens", "focal_length_mm": 30.0, "design_nm": DESIGN_NM}, metalens),
    "diverging metalens": ({"kind": "metalens", "focal_length_mm": -45.0, "design_nm": DESIGN_NM}, diverging),
    "hologram": (
        {
            "kind": "hologram",
            "construction_nm": DESIGN_NM,
            "point_1_mm": [2.0, -1.0, -60.0],
            "point_2_mm": [-1.0, 3.0, 45.0],
            "point_2": "virtual",
        },
        hologram,
    ),
    # Cubic splines have no error on cubics.
    "grid": ({"kind": "grid", "file": "phase.npz"}, xy),
}
BACK = {"kind": "radial", "coefficients_rad": [120.0, -15.0], "radius_mm": 5.0, "order": -1}


def back_phase(x: Any, y: Any) -> Any:
    u = (x * x + y * y) / 25
    return 120 * u - 15 * u**2


def conic(c: Any, k: Any, x: Any, y: Any) -> Any:
    r2 = x * x + y * y
    return c * r2 / (1 + mp.sqrt(1 - (1 + k) * c * c * r2))


def flat(x: Any, y: Any) -> Any:
    return mp.mpf(0)


def sphere(x: Any, y: Any) -> Any:
    return conic(1 / mp.mpf(17), mp.mpf(0), x, y)


def asphere(x: Any, y: Any) -> Any:
    r2 = x * x + y * y
    return conic(-1 / mp.mpf(24), mp.mpf("-1.5"), x, y) + mp.mpf(4e-4) * r2**2 + mp.mpf(-3e-6) * r2**3


SHAPES: dict[str, tuple[Keys, Phase]] = {
    "plane": ({}, flat),
    "sphere": ({"radius_mm": 17.0}, sphere),
    "asphere": ({"radius_mm": -24.0, "conic": -1.5, "asphere_mm": [4e-4, -3e-6]}, asphere),
}
POSES: dict[str, Keys | None] = {
    "as prescribed": None,
    "posed": {"tilt_deg": [4.0, -3.0, 25.0], "shift_mm": [0.3, -0.2, 0.1]},
}


def camera(front: Keys, back: Keys, *, index: float = 1.5, nm: float = NM, **lens: Any) -> lf.Scene:
    """Return a camera with a lens of two faces, 5 mm thick, and a sensor of 80 mm that is 10 mm behind it."""
    first = {"thickness_mm": THICKNESS, "index": index, "semi_diameter_mm": SEMI, "stop": True, **front}
    surfaces = [first, {"semi_diameter_mm": 1.5 * SEMI, **back}]
    sensor = {"pixels": (400, 400), "pixel_mm": 0.2, "distance_mm": GAP}
    return lf.Scene(
        camera={"lens": {"surfaces": surfaces, **lens}, "sensor": sensor}, transport={"wavelengths_nm": [nm]}
    )


def save_grid(path: Path) -> None:
    """Save samples of the polynomial, more of them along x than along y."""
    x, y = np.linspace(-4.5, 4.5, 19), np.linspace(-5.0, 5.0, 11)
    samples = [[float(xy(mp.mpf(a), mp.mpf(b))) for b in y] for a in x]
    np.savez(path, phase_rad=samples, spacing_mm=[0.5, 1.0], origin_mm=[-4.5, -5.0])


def rays(count: int, slope: float, seed: int = 0) -> tuple[Array, Array]:
    """Return rays through the middle of the front face, from 8 mm before it."""
    draw = np.random.default_rng(seed)
    d = np.column_stack([draw.uniform(-slope, slope, (count, 2)), np.ones(count)])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    at = np.column_stack([draw.uniform(-0.6 * SEMI, 0.6 * SEMI, (count, 2)), np.zeros(count)])
    return at - 8.0 * d, d


def traced(scene: lf.Scene, p: Array, d: Array, engine: str) -> lf.Paths:
    """Return the paths of rays that all reach the sensor's plane, in the order of the rays."""
    paths = lf.trace(lf.build(scene), p, d, split="transmit", engine=engine)
    np.testing.assert_array_equal(paths.source, np.arange(len(p)))
    assert set(paths.body) <= {"sensor", "beside the sensor"}
    return paths


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", PHASES)
def test_rays_turn_by_the_gradient_of_the_phase(kind: str, shape: str, pose: str, tmp_path: Path) -> None:
    """Two phases one behind the other, into the glass and out of it, in both engines."""
    keys, phase = PHASES[kind]
    if kind == "grid":
        save_grid(tmp_path / "phase.npz")
    form, sag = SHAPES[shape]
    placed = POSES[pose]
    elements = [] if placed is None else [{"surfaces": [0, 1], "pose": placed}]
    scene = camera({**form, "phase": keys}, {"radius_mm": -35.0, "phase": BACK}, elements=elements)
    scene = scene.in_folder(tmp_path)
    p, d = rays(10, 0.15, seed=len(kind) + len(shape))
    with mp.workdps(30):
        turn = None if placed is None else rotation(placed["tilt_deg"])
        shift = [mp.mpf(0)] * 3 if placed is None else [mp.mpf(s) for s in placed["shift_mm"]]
        faces = [
            Face(mp.mpf(0), sag, mp.mpf(1), mp.mpf(1.5), phase, keys.get("order", 1), turn, shift),
            Face(
                mp.mpf(THICKNESS), lambda x, y: conic(-1 / mp.mpf(35), mp.mpf(0), x, y), mp.mpf(1.5), mp.mpf(1),
                back_phase, -1, turn, shift,
            ),
        ]  # fmt: skip
        true = [through_faces(faces, at, to, NM, THICKNESS + GAP) for at, to in zip(p, d, strict=True)]
    position, direction, weight = (np.array([each[k] for each in true]) for k in range(3))
    # Not the picture of a lens without phases.
    bare = traced(camera(form, {"radius_mm": -35.0}, elements=elements), p, d, "mesh")
    assert np.linalg.norm(bare.position - position, axis=1).min() > 1e-3
    for engine in ENGINES:
        paths = traced(scene, p, d, engine)
        np.testing.assert_allclose(paths.position, position, atol=EXACT, rtol=0.0)
        np.testing.assert_allclose(paths.direction, direction, atol=EXACT, rtol=0.0)
        np.testing.assert_allclose(paths.weight, weight, atol=EXACT, rtol=0.0)


def plate(phase: Keys, *, on: str = "back", index: float = 1.5, nm: float = NM) -> lf.Scene:
    """Return a flat plate with a phase on one of its faces."""
    own = {"phase": phase}
    return camera(own if on == "front" else {}, own if on == "back" else {}, index=index, nm=nm)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("on", ["front", "back"])
@pytest.mark.parametrize("order", [-2, -1, 0, 1, 2])
def test_orders_of_a_grating_lie_on_a_cone_about_its_grooves(order: int, on: str, engine: str) -> None:
    """Skew rays keep their cosine along the grooves; across them it changes by mλ over the period (Born and Wolf)."""
    lines, turn = 300.0, np.deg2rad(25.0)
    p, d = rays(50, 0.5, seed=1)
    across, along = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([-np.sin(turn), np.cos(turn), 0.0])
    phase = {"kind": "grating", "lines_per_mm": lines, "direction_deg": 25.0, "order": order}
    paths = traced(plate(phase, on=on), p, d, engine)
    assert np.abs(d @ along).min() > 1e-3
    np.testing.assert_allclose(paths.direction @ along, d @ along, atol=EXACT, rtol=0.0)
    np.testing.assert_allclose(paths.direction @ across, d @ across + order * NM * 1e-6 * lines, atol=EXACT, rtol=0.0)


@pytest.mark.parametrize("engine", ENGINES)
def test_an_order_ends_where_its_sine_would_exceed_one(engine: str) -> None:
    """Sines from 1e-12 to 1e-2 below and above 1, out of glass; no light is lost, and none is there that cannot be."""
    step = 0.8
    excess = np.concatenate([side * 10.0 ** np.arange(-12.0, -1.5) for side in (-1.0, 1.0)])
    sine = 1.0 + excess - step
    d = np.column_stack([sine, np.zeros_like(sine), np.sqrt(1.0 - sine**2)])
    phase = {"kind": "grating", "lines_per_mm": step / (NM * 1e-6)}
    paths = lf.trace(lf.build(plate(phase)), -0.5 * d, d, split="transmit", engine=engine)
    there = np.isin(paths.body, ["sensor", "beside the sensor"])
    np.testing.assert_array_equal(np.sort(paths.source[there]), np.flatnonzero(excess < 0.0))
    np.testing.assert_allclose(paths.direction[there][:, 0], 1.0 + excess[paths.source[there]], atol=2e-15, rtol=0.0)
    assert abs(paths.ledger.imbalance) < EXACT
    assert not paths.ledger.lost_share


FOCAL = 10.0
PLATE_FOCUS = {"kind": "metalens", "focal_length_mm": FOCAL, "design_nm": DESIGN_NM}
PARALLEL = rays(40, 0.0, seed=2)
"""Rays along the axis."""


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_parallel_light_meets_in_the_focus_of_a_metalens(sign: float, engine: str) -> None:
    """f/1.25 on the back of a plate: all rays go through the focus, or come from it, at the design wavelength."""
    p, d = PARALLEL
    scene = plate(PLATE_FOCUS | {"focal_length_mm": sign * FOCAL}, nm=DESIGN_NM)
    paths = traced(scene, p, d, engine)
    back = (THICKNESS + sign * FOCAL - paths.position[:, 2]) / paths.direction[:, 2]
    at_focus = paths.position + back[:, None] * paths.direction
    np.testing.assert_allclose(at_focus[:, :2], 0.0, atol=EXACT, rtol=0.0)
    assert lf.first_order(scene).bfl_mm == pytest.approx(sign * FOCAL, rel=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("nm", [450.0, 650.0])
def test_other_wavelengths_focus_in_inverse_proportion(nm: float, engine: str) -> None:
    """Sines grow with the wavelength at every height, so that the paraxial focal length is f λ₀/λ."""
    p, d = PARALLEL
    scene = plate(PLATE_FOCUS, nm=nm)
    paths = traced(scene, p, d, engine)
    r = np.hypot(p[:, 0], p[:, 1])
    sine = nm / DESIGN_NM * r / np.hypot(r, FOCAL)
    height = r - GAP * sine / np.sqrt(1.0 - sine**2)
    np.testing.assert_allclose(paths.position[:, :2], p[:, :2] * (height / r)[:, None], atol=EXACT, rtol=0.0)
    low = 1e-3
    (crossing,) = traced(scene, np.array([[0.0, low, -1.0]]), np.array([[0.0, 0.0, 1.0]]), engine).direction
    focal = FOCAL * DESIGN_NM / nm
    assert -low * crossing[2] / crossing[1] == pytest.approx(focal, rel=(low / FOCAL) ** 2)
    assert lf.first_order(scene).bfl_mm == pytest.approx(focal, rel=1e-12)


def in_one_medium(phase: Keys, nm: float = NM) -> lf.Scene:
    """Return a phase in a medium of index 1.5 on all sides, where nothing is reflected."""
    medium = {"index": 1.5}
    surfaces = [
        {"thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 5.0, "stop": True, "phase": phase},
        {"index": 1.5, "semi_diameter_mm": 500.0},
    ]
    sensor = {"pixels": (40, 40), "pixel_mm": 1.0, "distance_mm": 2.0}
    return lf.Scene(
        camera={"lens": {"surfaces": surfaces}, "object_medium": medium, "sensor": sensor},
        transport={"wavelengths_nm": [nm]},
    )


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("second", ["real", "virtual"])
@pytest.mark.parametrize("first", ["real", "virtual"])
def test_a_hologram_turns_its_first_wave_into_the_second(first: str, second: str, engine: str) -> None:
    """Rays from or to the point 1 leave from or to the point 2, at 0.4 and 0.6 rad, at the construction wavelength."""
    points = {"real": -1.0, "virtual": 1.0}
    one, two = np.array([9.0, -4.0, 30.0 * points[first]]), np.array([-12.0, 5.0, 18.0 * points[second]])
    phase = {
        "kind": "hologram", "point_1_mm": one.tolist(), "point_2_mm": two.tolist(), "point_1": first,
        "point_2": second, "construction_nm": NM / 1.5,
    }  # fmt: skip
    draw = np.random.default_rng(4)
    at = np.column_stack([draw.uniform(-3.0, 3.0, (40, 2)), np.zeros(40)])
    d = (at - one) * -points[first]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    paths = traced(in_one_medium(phase), at - 2.0 * d, d, engine)
    t = (two[2] - paths.position[:, 2]) / paths.direction[:, 2]
    np.testing.assert_allclose(paths.position + t[:, None] * paths.direction, np.tile(two, (40, 1)), atol=1e-11)


# Light in the orders


BK7_B, BK7_C = (1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)
BK7 = {"sellmeier_b": list(BK7_B), "sellmeier_c_um2": list(BK7_C)}


def bk7(nm: float) -> float:
    """Return the index of N-BK7 by Schott's dispersion formula."""
    w2 = (nm * 1e-3) ** 2
    return float(np.sqrt(1.0 + sum(b * w2 / (w2 - c) for b, c in zip(BK7_B, BK7_C, strict=True))))


def light_in_order(nm: float, order: int, engine: str, **efficiency: Any) -> float:
    """Return the share of the light in an order of a plate of N-BK7, from a ray along the axis."""
    phase = {"kind": "grating", "lines_per_mm": 10.0, "order": order, **efficiency}
    scene = plate(phase, nm=nm).changed({"camera.lens.surfaces[0].index": None, "camera.lens.surfaces[0].glass": BK7})
    (weight,) = traced(scene, np.array([[0.5, 0.2, -1.0]]), np.array([[0.0, 0.0, 1.0]]), engine).weight
    n = bk7(nm)
    return float(weight / (4.0 * n / (n + 1.0) ** 2) ** 2)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("nm", [450.0, 550.0, 656.3])
@pytest.mark.parametrize(("order", "blazed"), [(0, 1), (1, 1), (2, 1), (-1, 1), (2, 2)])
def test_a_blaze_has_the_shares_of_scalar_theory(order: int, blazed: int, nm: float, engine: str) -> None:
    """sinc²(α − m) with the blaze's depth in waves, α (Buralli, Morris, Rogers, Applied Optics 28, 1989, 976)."""
    depth = blazed * DESIGN_NM / nm * (bk7(nm) - 1.0) / (bk7(DESIGN_NM) - 1.0)
    found = light_in_order(nm, order, engine, efficiency="blaze", design_nm=DESIGN_NM, blaze_order=blazed)
    assert found == pytest.approx(np.sinc(depth - order) ** 2, abs=EXACT)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("levels", "published"), [(2, 0.405), (4, 0.81), (8, 0.95), (16, 0.99)])
def test_a_blaze_in_steps_has_the_published_efficiency(levels: int, published: float, engine: str) -> None:
    """Swanson, Binary optics technology, MIT Lincoln Laboratory TR-854, 1989: 40.5, 81, 95 and 99 % in first order.

    Elsewhere the steps are added as phasors: the share is |Σ exp(2πi k (α − m)/N)/N|² sinc²(m/N).
    """
    steps = {"efficiency": "blaze", "design_nm": DESIGN_NM, "levels": levels}
    designed = light_in_order(DESIGN_NM, 1, engine, **steps)
    assert designed == pytest.approx(published, abs=5e-3)
    assert designed == pytest.approx(np.sinc(1.0 / levels) ** 2, abs=EXACT)
    for nm, order in ((450.0, 1), (656.3, 1), (450.0, 2), (656.3, 0)):
        depth = DESIGN_NM / nm * (bk7(nm) - 1.0) / (bk7(DESIGN_NM) - 1.0)
        phasors = np.exp(2j * np.pi * np.arange(levels) * (depth - order) / levels).mean()
        share = abs(phasors) ** 2 * np.sinc(order / levels) ** 2
        assert light_in_order(nm, order, engine, **steps) == pytest.approx(share, abs=EXACT)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_measured_efficiency_is_interpolated(engine: str) -> None:
    table = {"wavelengths_nm": [400.0, 500.0, 700.0], "values": [0.5, 0.9, 0.3]}
    for nm, share in ((400.0, 0.5), (475.0, 0.8), (600.0, 0.6), (700.0, 0.3)):
        assert light_in_order(nm, 1, engine, efficiency=table) == pytest.approx(share, abs=EXACT)


def test_a_path_without_an_order_has_the_light_of_the_refracted_ray() -> None:
    """A face turns the ray by 64 degrees at least; the light that passes is that of Fresnel's equations before it."""
    step = 0.6
    sine = 0.3
    d = np.array([[sine, 0.0, np.sqrt(1.0 - sine**2)]])
    phase = {"kind": "grating", "lines_per_mm": step / (NM * 1e-6)}
    (weight,) = traced(plate(phase), -0.5 * d, d, "mesh").weight
    cos_i, cos_t = np.sqrt(1.0 - sine**2), np.sqrt(1.0 - (sine / 1.5) ** 2)
    r_s = (cos_i - 1.5 * cos_t) / (cos_i + 1.5 * cos_t)
    r_p = (1.5 * cos_i - cos_t) / (1.5 * cos_i + cos_t)
    assert weight == pytest.approx((1.0 - 0.5 * (r_s**2 + r_p**2)) ** 2, abs=EXACT)


# A hybrid lens


RADIUS, NORM = 60.0, 8.0
HYBRID = {"kind": "radial", "coefficients_rad": [-158.5, 4.0], "radius_mm": NORM, "order": 1}
LINES = (486.1, 587.6, 656.3)


def meridional_focus(height: float, nm: float, with_phase: bool) -> float:
    """Return where a ray parallel to the axis crosses it behind a convex-plane singlet, by angles in its own plane."""
    n = bk7(nm)
    incidence = np.arcsin(height / RADIUS)
    inside = incidence - np.arcsin(np.sin(incidence) / n)
    sag = RADIUS - np.sqrt(RADIUS**2 - height**2)
    y = height - (THICKNESS - sag) * np.tan(inside)
    sine = n * np.sin(inside)
    if with_phase:
        u = y / NORM
        sine -= nm * 1e-6 / (2.0 * np.pi) * (2.0 * -158.5 * u + 4.0 * 4.0 * u**3) / NORM
    return float(y * np.sqrt(1.0 - sine**2) / sine)


def hybrid(nm: float, with_phase: bool = True) -> lf.Scene:
    back = {"phase": HYBRID} if with_phase else {}
    return camera({"radius_mm": RADIUS, "glass": BK7, "index": None}, back, nm=nm)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("nm", LINES)
def test_a_hybrid_singlet_focuses_as_a_meridional_trace_says(nm: float, engine: str) -> None:
    heights = np.array([1e-3, 0.5, 1.0, 2.0, 3.0, 3.9])
    p = np.column_stack([0.0 * heights, heights, np.full(6, -3.0)])
    paths = traced(hybrid(nm), p, np.tile([0.0, 0.0, 1.0], (6, 1)), engine)
    crossing = GAP - paths.position[:, 1] * paths.direction[:, 2] / paths.direction[:, 1]
    true = [meridional_focus(h, nm, True) for h in heights]
    np.testing.assert_allclose(crossing, true, rtol=1e-11)
    assert lf.first_order(hybrid(nm)).bfl_mm == pytest.approx(meridional_focus(1e-4, nm, True), rel=1e-9)


def test_a_weak_phase_undoes_the_colour_of_a_singlet() -> None:
    """Its focus moves by 1.8 mm from line F to line C, that of the hybrid by less than a tenth of that."""
    shifts = [
        lf.first_order(hybrid(486.1, own)).bfl_mm - lf.first_order(hybrid(656.3, own)).bfl_mm for own in (False, True)
    ]
    true = [meridional_focus(1e-4, 486.1, own) - meridional_focus(1e-4, 656.3, own) for own in (False, True)]
    assert shifts == pytest.approx(true, rel=1e-6)
    assert abs(shifts[1]) < 0.1 * abs(shifts[0])
