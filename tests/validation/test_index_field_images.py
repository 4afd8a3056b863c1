"""Pictures through media that bend light: radiance, energy, both methods, shadowgraphs, dots behind a plume.

Along a ray L/n² is constant, so that a room of one temperature looks the same through any field.
"""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image as Picture
from scipy import stats
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import lfmesh as lf
from tests.cameras import close_up_camera
from tests.instances import instances
from tests.optics.closed_fields import ball_deflection
from tests.renders import by_seed, unchecked
from tests.validation.field_scenes import Tables, ball_of, box_of, grid_of, nodes
from tests.validation.test_forward_equals_adjoint import LEVEL, POINT, plane
from tests.validation.test_kirchhoff import HOT, MATT, MIDDLE, assert_black, ball, room
from tests.validation.test_phase_images import compared

Array = NDArray[np.float64]

# Grids of tests whose truth needs no exact grid, or that are known to more than what they test.
pytestmark = pytest.mark.filterwarnings("ignore::lfmesh.errors.CoarseFieldWarning")

# A room of one temperature


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder for grids, with a coarse chart that looks like none of its mirror images."""
    there = tmp_path_factory.mktemp("fields")
    levels = np.random.default_rng(5).integers(90, 256, (5, 6)).astype(np.uint8)
    levels[0, 0], levels[-1, 1] = 0, 255
    Picture.fromarray(levels).save(there / "chart.png")
    return there


IN_THE_MIDDLE: Tables = {"position_mm": MIDDLE, "rotation_deg": (10.0, 20.0, 5.0)}
DUCT: Tables = {"kind": "radial_n2", "index": 1.0005, "coefficients": [-1e-6]}
ROOMS: dict[str, tuple[Tables | None, list[Tables], dict[str, Any]]] = {
    # Keys beside those of a strong ball, or None and the whole medium; bodies; settings.
    "a strong ball": ({}, [], {}),
    "a strong ball that absorbs": (HOT | {"absorption_per_mm": 0.03}, [], {}),
    "a strong ball that scatters": (HOT | {"absorption_per_mm": 0.01, "scattering_per_mm": 0.02}, [],
                                    {"samples": 2**13}),
    "a matt ball in a strong ball": ({}, [ball(MATT, 5.0)], {"samples": 2**12}),
    "a strong ball in a matt room": ({}, [], {"wall": MATT}),
    "hot gas": (None, [], {"media": [
        box_of(50.0, pressure_kpa=101.325, absorption_per_mm=0.02, **HOT) | IN_THE_MIDDLE
    ]}),
    "a duct": (None, [], {"media": [box_of(50.0, index=DUCT) | IN_THE_MIDDLE]}),
}  # fmt: skip


def room_with(case: str, folder: Path, delta: float = 0.1, **more: Any) -> lf.Scene:
    """Return a room with a field, whose index is up to 1 + δ if it is a ball."""
    keys, bodies, settings = ROOMS[case]
    media = [] if keys is None else [ball_of(folder, delta, 8.0, 61) | keys | IN_THE_MIDDLE]
    return room(bodies, folder, **{"samples": 2**11, "media": media, **settings, **more})


@pytest.mark.parametrize("case", ROOMS)
def test_a_room_of_one_temperature_looks_the_same_through_a_field(case: str, folder: Path) -> None:
    assert_black(room_with(case, folder), folder, 0.01)


@pytest.mark.parametrize(
    ("case", "samples", "sigma"),
    [
        pytest.param("a strong ball in a matt room", 2**16, 0.05, marks=pytest.mark.long),
        ("a strong ball that scatters", 2**12, 0.1),
    ],
)
def test_a_room_of_one_temperature_looks_the_same_to_packets_from_its_walls(
    case: str, samples: int, sigma: float, folder: Path
) -> None:
    assert_black(room_with(case, folder, 1e-3, samples=samples, method="forward"), folder, sigma)


# The light of all rays


def blobs_of(folder: Path, draw: np.random.Generator, amplitude: float, size: float, quantity: str = "index") -> Tables:
    """Return a random smooth field on a cubic grid of a given width, which fades towards its faces."""
    count = 25
    at = nodes(count, size / count)
    total = np.zeros((count, count, count))
    for sign in (1.0, -1.0, 1.0):
        centre, width = draw.uniform(-0.1, 0.1, 3) * size, draw.uniform(0.12, 0.16) * size
        total += sign * np.exp(-((at - centre) ** 2).sum(axis=-1) / width**2)
    if quantity == "index":
        return grid_of(folder, size / count, index=1.0 + amplitude * total)
    # Air of 0.2 to 2 times the density around, by heat at its pressure or in kg/m³.
    share = 1.0 + np.clip(0.8 * total, -0.8, 1.0)
    if quantity == "temperature_k":
        return grid_of(folder, size / count, temperature_k=293.15 / share) | {"pressure_kpa": 101.325}
    return grid_of(folder, size / count, density_kg_m3=1.20411 * share)


@pytest.mark.parametrize("number", range(4))
def test_the_ledger_accounts_for_all_light(number: int, folder: Path) -> None:
    """Of rays through random fields that absorb and scatter, with matt and clear bodies in them or near by."""
    draw = np.random.default_rng([3, number])
    coefficients = [{}, {"absorption_per_mm": 0.02}, {"scattering_per_mm": 0.03}, {"absorption_per_mm": 0.01,
                    "scattering_per_mm": 0.02}][number]  # fmt: skip
    field = blobs_of(folder, draw, (0.05, 1e-3, 0.05, 2e-4)[number], 20.0) | coefficients
    field |= {"position_mm": (0.0, 0.0, -30.0), "rotation_deg": draw.uniform(-90.0, 90.0, 3).tolist()}
    inside = {"shape": {"kind": "sphere", "radius_mm": 2.0}, "position_mm": (1.0, 0.0, -30.0)}
    scene = lf.Scene(
        camera=close_up_camera(), media=[field],
        targets=[plane({"reflectance": 0.8}), inside | {"material": {"reflectance": 0.5}}][number % 2 :],
    ).in_folder(folder)  # fmt: skip
    origins = draw.uniform([-12.0, -12.0, -42.0], [12.0, 12.0, -18.0], (400, 3))
    d = draw.normal(size=(400, 3))
    paths = lf.trace(lf.build(scene), origins, d, max_events=200)
    ledger = paths.ledger
    assert abs(ledger.imbalance) < 1e-12
    assert not ledger.lost_share
    assert sum(ledger.absorbed.values()) > 5.0
    assert ledger.escaped > 10.0


def test_threads_do_not_change_a_picture_through_a_field(folder: Path) -> None:
    scene = drawn(0, folder).changed({"transport.samples": 16})
    one, two = (unchecked(scene.changed({"transport.threads": n})).mean for n in (1, 2))
    assert np.array_equal(one, two)


# Both methods

FIELDS = 30
IN_SUITE = (0, 6, 13)
KINDS = ("index", "density_kg_m3", "temperature_k", "duct", "linear")
LIGHTS = ("glow", "lamp", "fog")


def drawn(number: int, folder: Path) -> lf.Scene:
    """Draw a random field before a chart that shines, or on the way of a lamp's light to it; or in a field of fog."""
    draw = np.random.default_rng([9, number])
    kind, light = KINDS[number % len(KINDS)], LIGHTS[number // len(KINDS) % len(LIGHTS)]
    size = 10.0 if light == "lamp" else 18.0
    if kind == "duct":
        field = box_of(size, index=DUCT | {"coefficients": [float(draw.choice([-4e-6, 4e-6]))]})
    elif kind == "linear":
        field = box_of(size, index={"kind": "xyz", "index": 1.0, "y_coefficients": [6e-5]})
    else:
        field = blobs_of(folder, draw, draw.uniform(0.01, 0.04), size, kind)
    field["rotation_deg"] = draw.uniform(-180.0, 180.0, 3).tolist()
    centre = np.array((10.0, -7.5, -42.5) if light == "lamp" else (0.0, 0.0, -32.0))
    field["position_mm"] = (centre + draw.uniform(-1.5, 1.5, 3)).tolist()
    if light == "fog":
        # What absorbs would emit by its temperature, and needs bands.
        field |= {"scattering_per_mm": 0.01} | ({} if kind == "temperature_k" else {"absorption_per_mm": 0.01})
    glow = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": "chart.png"}
    painted = {"reflectance": 0.8, "texture": "chart.png"}
    return lf.Scene(
        camera=close_up_camera(), media=[field], targets=[plane(painted if light == "lamp" else glow)],
        lights=[POINT] if light == "lamp" else [], transport={"split": "transmit", "threads": 1},
    ).in_folder(folder)  # fmt: skip


@pytest.mark.parametrize("number", instances(range(FIELDS), long=[n for n in range(FIELDS) if n not in IN_SUITE]))
def test_forward_equals_adjoint_through_random_fields(number: int, folder: Path) -> None:
    """Welch's t-tests of squares of pixels and of their sum, each field at LEVEL (Bonferroni)."""
    scene = drawn(number, folder)
    error, found = compared(scene, (32, 96) if number in IN_SUITE else (192, 576))
    assert 3.0 * error < (0.08 if number in IN_SUITE else 0.04)
    worst = min(found, key=lambda name: found[name])
    assert found[worst] > LEVEL / len(found), f"{worst}: {found[worst]:.2g}\n{scene.dump_toml()}"


def test_the_random_fields_have_every_kind_and_every_light(folder: Path) -> None:
    seen = {(KINDS[n % len(KINDS)], LIGHTS[n // len(KINDS) % len(LIGHTS)]) for n in range(FIELDS)}
    assert len(seen) == len(KINDS) * len(LIGHTS)
    assert {LIGHTS[n // len(KINDS) % len(LIGHTS)] for n in IN_SUITE} == set(LIGHTS)
    assert len({KINDS[n % len(KINDS)] for n in IN_SUITE}) == len(IN_SUITE)


# A shadowgraph

WIDTH, AWAY, SCREEN, TILT = 8.0, 300.0, 400.0, np.radians(40.0)
"""Radius of a ball, its distance from the screen, that of the screen from the camera, mm; the light's angle to z."""


@cache
def shadow_law(delta: float) -> tuple[CubicSpline, CubicSpline]:
    """Return the distance from the axis in the screen, and its derivative, by the distance b of a parallel ray.

    A ray leaves a ball as far from its centre as it came, so that it meets a plane across the axis, a distance L behind
    the centre, at b / cos θ − L tan θ.
    """
    impacts = np.linspace(0.0, 6.0, 49)
    theta = np.array([0.0, *(ball_deflection(delta, WIDTH, b) for b in impacts[1:])])
    spline = CubicSpline(impacts, impacts / np.cos(theta) - AWAY * np.tan(theta))
    return spline, spline.derivative()


def shadow(delta: float, half: float) -> float:
    """Return the mean irradiance on a square of the screen about the axis, over that without the ball."""
    radius, rate = shadow_law(delta)
    at, weights = np.polynomial.legendre.leggauss(12)
    x, y = np.meshgrid(half * np.cos(TILT) * at, half * at)
    rho = np.hypot(x, y)
    impacts = np.linspace(0.0, 6.0, 20_001)
    b = np.interp(rho, radius(impacts), impacts)
    return float((b / (rho * rate(b)) * 0.25 * np.outer(weights, weights)).sum())


def shadowgraph(folder: Path, delta: float | None, method: str) -> lf.Scene:
    """Return a camera that looks at a matt screen, and parallel light that meets its middle by way of a ball."""
    along = np.array([np.sin(TILT), 0.0, -np.cos(TILT)])
    media = []
    if delta is not None:
        where = {"position_mm": ([0.0, 0.0, -SCREEN] - AWAY * along).tolist(), "rotation_deg": (0.0, 140.0, 0.0)}
        media = [ball_of(folder, delta, WIDTH, 77) | where]
    lens = {"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 8.0, "stop": True}
    screen = {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": (0.0, 0.0, -SCREEN),
              "material": {"reflectance": 0.8}}  # fmt: skip
    sun = {"kind": "directional", "direction": along.tolist(), "irradiance_w_m2": 1.0}
    # 4 × 4 pixels of 1 mm on the screen.
    camera = {"focus_mm": SCREEN, "lens": {"surfaces": [lens]}, "sensor": {"pixels": (4, 4), "pixel_mm": 1.0 / 7.0}}
    samples = 2**14 if method == "adjoint" else 2**19
    settings = {"method": method, "samples": samples, "replicates": 1, "split": "transmit", "threads": 1}
    return lf.Scene(
        camera=camera,  # type: ignore[arg-type]
        media=media,
        targets=[screen],  # type: ignore[list-item]
        lights=[sun],  # type: ignore[list-item]
        transport=settings,  # type: ignore[arg-type]
    ).in_folder(folder)


@pytest.mark.parametrize("method", instances(["adjoint", "forward"], long=["forward"]))
@pytest.mark.parametrize("delta", [1.5e-3, -1.5e-3])
def test_a_ball_magnifies_its_shadow(delta: float, method: str, folder: Path) -> None:
    """On its axis, light is spread or gathered by 1/(1 − L/f)², with 1/f = 2 δ √π / w."""
    on_axis = 1.0 / (1.0 - AWAY * 2.0 * delta * np.sqrt(np.pi) / WIDTH) ** 2
    assert shadow(delta, 1e-3) == pytest.approx(on_axis, rel=3e-3)
    plain = np.mean([image.mean[..., 0] for image in by_seed(shadowgraph(folder, None, "adjoint"), range(8))], axis=0)
    images = np.array([image.mean[..., 0] for image in by_seed(shadowgraph(folder, delta, method), range(24))])
    for inner, half in ((slice(1, 3), 1.0), (slice(None), 2.0)):
        found = images[:, inner, inner].sum(axis=(1, 2)) / plain[inner, inner].sum()
        assert stats.sem(found) < 0.15 * abs(on_axis - 1.0)
        assert stats.ttest_1samp(found, shadow(delta, half)).pvalue > LEVEL / 2


# Dots behind a plume

DOTS_MM, PLUME_MM, FADED_MM = 1000.0, 700.0, 50.0
"""Distances of the dots and of the plume's axis from the lens, and from that axis to where the plume has faded."""

AXIS = np.array([0.0, 0.0, -PLUME_MM])
DOT_MM, PITCH_MM = 0.3, 8.0
DEPTH, WIDEST = 6e-4, 8.0
FINE_MM, FINE = 0.005, 200
"""Pitch and number of the pixels along a side."""

ITERATIONS = 6
"""Corrections of the slope of a ray that is to meet a point; each leaves a fiftieth of the error."""

SENSOR_MM = 1.0 / (1.0 / 50.0 - 1.0 / DOTS_MM)
"""Distance of the dots' image from the lens."""


def plume(x: Any, y: Any, z: Any) -> Any:
    """Return the index of a plume about its own origin that rises along y: it widens and fades with height."""
    width = WIDEST * (1.0 + 0.005 * y)
    return 1.0 - DEPTH * (WIDEST / width) ** 2 * np.exp(-(x * x + z * z) / width**2)


def rates(_: float, state: Array, size: float) -> Array:
    """Return dr/dσ = T and dT/dσ = n ∇n in the plume, with differences of the formula for its gradient."""
    at, step = (state[:3] - AXIS) / size, 1e-4
    gradient = [(plume(*(at + e)) - plume(*(at - e))) / (2.0 * step * size) for e in step * np.eye(3)]
    return np.concatenate([state[3:], plume(*at) * np.array(gradient)])


def landing(point: Array, size: float = 1.0) -> Array:
    """Return where the chief ray of a point of the dots' plane meets the sensor, (2,) mm.

    The path integral through a plume of some times the size is SciPy's, from the centre of the lens, which bends no ray
    there.
    """

    def missed(slope: Array) -> Array:
        d = np.array([*slope, -1.0])
        start = (PLUME_MM - FADED_MM * size) * d
        d /= np.linalg.norm(d)
        through = (0.0, -2.0 * FADED_MM * size / d[2])
        end = solve_ivp(
            rates, through, [*start, *d], args=(size,), rtol=1e-11, atol=1e-12, method="DOP853", max_step=4.0 * size
        ).y[:, -1]  # fmt: skip
        return np.asarray((end[:3] - (DOTS_MM + end[2]) / end[5] * end[3:])[:2] - point, np.float64)

    slope = point / DOTS_MM
    for _ in range(ITERATIONS):
        slope = slope - missed(slope) / DOTS_MM
    return np.asarray(-SENSOR_MM * slope, np.float64)


def dots() -> Array:
    """Return the centres of the dots, (9, 2) mm."""
    x = PITCH_MM * np.array([-1.0, 0.0, 1.0]) + 0.5
    return np.array([(a, b) for a in x for b in x])


def board(folder: Path, targets: list[Tables], size: float | None, seed: int = 0) -> lf.Scene:
    """Return a camera that looks at targets that shine, through a plume of some times the size, or None."""
    at, media = nodes((81, 61, 81)), []
    if size is not None:
        media = [grid_of(folder, size, index=plume(*np.moveaxis(at, -1, 0)))]
        media[0] |= {"position_mm": AXIS.tolist(), "rotation_deg": (0.0, 0.0, 0.0)}
    lens = {"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 0.5, "stop": True}
    camera = {
        "focus_mm": DOTS_MM, "lens": {"surfaces": [lens]}, "sensor": {"pixels": (FINE, FINE), "pixel_mm": FINE_MM}
    }  # fmt: skip
    settings = {"split": "transmit", "samples": 64, "replicates": 8, "threads": 1, "seed": seed}
    return lf.Scene(
        camera=camera,  # type: ignore[arg-type]
        media=media,
        targets=targets,  # type: ignore[arg-type]
        transport=settings,  # type: ignore[arg-type]
    ).in_folder(folder)


def disks() -> list[Tables]:
    """Return a disk that shines at each dot."""
    glow = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}
    shape = {"kind": "disk", "radius_mm": DOT_MM}
    return [{"shape": shape, "position_mm": (*at.tolist(), -DOTS_MM), "material": glow} for at in dots()]


def centroids(image: lf.Image) -> tuple[Array, Array]:
    """Return the centroids of the images of the dots, (9, 2) mm, and their standard errors."""
    mean, error = image.mean[..., 0], image.stderr[..., 0]
    along = FINE_MM * (np.arange(FINE) - 0.5 * (FINE - 1))
    found, errors = [], []
    for point in -SENSOR_MM / DOTS_MM * dots():
        near = [np.abs(along - c) < 0.4 * PITCH_MM * SENSOR_MM / DOTS_MM for c in point]
        window = np.ix_(near[1], near[0])
        light, of_light = mean[window], error[window]
        total = light.sum()
        centre = np.array([(light.sum(axis=0) @ along[near[0]]), (light.sum(axis=1) @ along[near[1]])]) / total
        off = [(along[near[0]] - centre[0])[None, :], (along[near[1]] - centre[1])[:, None]]
        found.append(centre)
        errors.append([np.sqrt(((each * of_light) ** 2).sum()) / total for each in off])
    return np.array(found), np.array(errors)


@pytest.mark.long
def test_dots_behind_a_plume_are_shifted_by_the_path_integral(folder: Path) -> None:
    """As in background-oriented schlieren: up to three pixels, each known to 2 % of that."""
    still, bent = (centroids(unchecked(board(folder, disks(), size))) for size in (None, 1.0))
    # A disk has the mean of four points at its radius over √2, up to third derivatives.
    beside = DOT_MM / np.sqrt(2.0) * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    truth = np.array([np.mean([landing(at + each) for each in beside], axis=0) for at in dots()])
    shift = truth + SENSOR_MM / DOTS_MM * dots()
    assert 0.008 < np.abs(shift).max() < 0.03
    error = np.hypot(still[1], bent[1])
    assert error.max() < 0.02 * np.abs(shift).max()
    z = (bent[0] - still[0] - shift) / error
    assert stats.chi2.sf((z**2).sum(), z.size) > LEVEL, z
    assert np.abs(z).max() < 4.0, z


WINDOW = 21
"""Width of the windows of a schlieren evaluation, pixels."""

LARGE_MM, LARGE = 0.02, 3.0
"""Pitch of its pixels, and the size of its plume, over that of the dots above: its windows are then small beside it."""


def speckles(folder: Path) -> list[Tables]:
    """Return a plane with random dots that shines."""
    draw = np.random.default_rng(8)
    count, width = 700, 70.0
    x, y = np.meshgrid(*[(np.arange(count) + 0.5) * width / count] * 2)
    light = np.full((count, count), 0.1)
    for at_x, at_y in draw.uniform(0.0, width, (2500, 2)):
        i, j = (int(np.clip(c / width * count, 20, count - 20)) for c in (at_x, at_y))
        near = slice(j - 20, j + 20), slice(i - 20, i + 20)
        light[near] += 0.8 * np.exp(-((x[near] - at_x) ** 2 + (y[near] - at_y) ** 2) / 0.6**2)
    Picture.fromarray((255.0 * light.clip(0.0, 1.0)).astype(np.uint8)).save(folder / "speckles.png")
    return [
        {"shape": {"kind": "plane", "width_mm": width, "height_mm": width}, "position_mm": (0.0, 0.0, -DOTS_MM),
         "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": "speckles.png"}}
    ]  # fmt: skip


def test_schlieren_of_a_plume_are_path_integrals(folder: Path) -> None:
    """`lf.schlieren` of two runs, in windows that do not overlap, within the standard errors that it states."""
    pixels = 140
    large = {"camera.sensor.pixels": (pixels, pixels), "camera.sensor.pixel_mm": LARGE_MM}
    targets = speckles(folder)
    run, reference = (
        lf.render(board(folder, targets, size, seed).changed(large)) for seed, size in enumerate((LARGE, None))
    )
    found = lf.schlieren(run, reference, window=WINDOW, step=WINDOW)
    sample = LARGE_MM * DOTS_MM / SENSOR_MM
    np.testing.assert_allclose(found.sample_mm, sample, rtol=1e-9)
    middle = 0.5 * (pixels - 1)
    # The mean over a square is that of four points at its width over √6.
    beside = WINDOW * sample / np.sqrt(6.0) * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    truth = np.zeros_like(found.displacement_px)
    for row, t in enumerate(found.t_px):
        for column, s in enumerate(found.s_px):
            points = sample * np.array([s - middle, middle - t]) + beside
            shifts = [landing(at, LARGE) + SENSOR_MM / DOTS_MM * at for at in points]
            # The lens turns pictures round.
            truth[row, column] = -np.mean(shifts, axis=0) / LARGE_MM
    assert np.abs(truth).max() > 0.5
    z = (found.displacement_px - truth) / found.displacement_error_px
    assert found.displacement_error_px.max() < 0.1 * np.abs(truth).max()
    assert stats.chi2.sf((z**2).sum(), z.size) > LEVEL, z
    apart = found.background_mm - found.field_mm
    assert apart == pytest.approx(DOTS_MM - PLUME_MM, rel=1e-9)
    np.testing.assert_allclose(found.deflection_rad * apart, -found.displacement_px * found.sample_mm, rtol=1e-9)
