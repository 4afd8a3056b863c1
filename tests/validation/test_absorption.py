"""Glass and liquids that absorb: Bouguer's law along every path, by the lengths that rays travel.

Lengths are taken from closed forms, or from the vertices of rays that the same scene without absorption has recorded.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial.transform import Rotation

import lfmesh as lf
from lfmesh.optics.fresnel import fresnel
from lfmesh.optics.glass import absorption_per_mm
from tests.cameras import camera_without_array, close_up_camera
from tests.renders import by_seed

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds."""

CENTRE = np.array([0.0, 0.0, -300.0])
DENSE = "SCHOTT/N-SF6"
VIOLET_NM = 372.0
"""Where 10 mm of this glass transmit about half."""


def body(size: Any, index: float, turned: Any = (0.0, 0.0, 0.0), **refractor: Any) -> dict[str, Any]:
    return {
        "refractor": {"box_mm": [float(x) for x in size], "index": index} | refractor,
        "position_mm": CENTRE.tolist(),
        "rotation_deg": [float(x) for x in turned],
    }


def world(*targets: dict[str, Any], **transport: Any) -> Any:
    return lf.build(lf.Scene(camera=camera_without_array(), targets=list(targets), transport=transport))


def towards_centre(normal: Array, count: int, random: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return rays to the centre from all sides of a normal, up to 75 degrees, and the cosines of incidence."""
    cosine, turn = random.uniform(np.cos(np.deg2rad(75.0)), 1.0, count), random.uniform(0.0, 2.0 * np.pi, count)
    sine = np.sqrt(1.0 - cosine**2)
    local = np.column_stack([sine * np.cos(turn), sine * np.sin(turn), -cosine])
    axes = np.linalg.qr(np.column_stack([normal, random.normal(size=(3, 2))]))[0]
    axes[:, 0] *= np.sign(axes[:, 0] @ normal)
    d = local @ np.column_stack([axes[:, 1], axes[:, 2], axes[:, 0]]).T
    return CENTRE - 60.0 * d, d, cosine


def test_a_plate_transmits_the_share_of_its_slant_thickness() -> None:
    """Random plates: T² exp(−α d / cos θ') straight through, and with all reflections T² e / (1 − R² e²)."""
    random = np.random.default_rng(11)
    for _ in range(6):
        index, thickness, alpha = random.uniform(1.1, 2.5), random.uniform(0.5, 9.0), 10.0 ** random.uniform(-3.0, -0.3)
        turned = random.uniform(-180.0, 180.0, 3)
        normal = Rotation.from_euler("xyz", turned, degrees=True).apply([0.0, 0.0, 1.0])
        built = world(body((900.0, 900.0, thickness), index, turned, absorption_per_mm=alpha))
        p, d, cosine = towards_centre(normal, 40, random)
        inside = np.sqrt(1.0 - (1.0 - cosine**2) / index**2)
        share = np.exp(-alpha * thickness / inside)
        reflectance, transmittance = np.array([fresnel(1.0, index, c)[:2] for c in cosine]).T
        straight = lf.trace(built, p, d, split="transmit")
        assert straight.source.tolist() == list(range(40))
        np.testing.assert_allclose(straight.weight, transmittance**2 * share, rtol=1e-12)
        np.testing.assert_allclose(
            straight.ledger.absorbed["inside targets[0]"], (transmittance * (1.0 - share)).sum(), rtol=1e-11
        )
        paths = lf.trace(built, p, d, split="both", weight_cutoff=0.0, max_events=14)
        ahead = (paths.direction * d[paths.source]).sum(axis=1) > 1.0 - 1e-9
        through = np.bincount(paths.source[ahead], paths.weight[ahead], minlength=40)
        orders = transmittance**2 * share / (1.0 - (reflectance * share) ** 2)
        # Seven orders are followed.
        assert (np.abs(through - orders) <= (reflectance * share) ** 10 + 1e-12).all()
        assert abs(paths.ledger.imbalance) < 1e-12


def test_light_in_a_guide_decays_with_the_length_of_its_zigzag() -> None:
    """A bar's sides reflect it totally, as often as it takes: exp(−α L / cos θ') whatever the number of reflections."""
    length, index, alpha = 90.0, 1.7, 0.02
    built = world(body((4.0, 3.0, length), index, absorption_per_mm=alpha))
    random = np.random.default_rng(12)
    angle, turn = np.deg2rad(random.uniform(5.0, 60.0, 200)), random.uniform(0.0, 2.0 * np.pi, 200)
    d = np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), -np.cos(angle)])
    entry = CENTRE + np.column_stack([random.uniform(-1.0, 1.0, (200, 2)), np.full(200, 0.5 * length)])
    paths = lf.trace(built, entry - d, d, split="both", weight_cutoff=0.0, max_events=40)
    # A packet that escapes ends where it left the bar.
    out = (np.abs(paths.position[:, 2] - CENTRE[2] + 0.5 * length) < 1e-9) & (paths.direction[:, 2] < 0.0)
    # Of each ray the strongest packet ahead has met the far face once; the others were reflected there before.
    first = np.zeros(200)
    np.maximum.at(first, paths.source[out], paths.weight[out])
    inside = np.sqrt(1.0 - (np.sin(angle) / index) ** 2)
    share = np.array([fresnel(1.0, index, c)[1] for c in np.cos(angle)]) ** 2 * np.exp(-alpha * length / inside)
    np.testing.assert_allclose(first, share, rtol=1e-11)
    assert paths.events[out].max() > 10


def test_a_coefficient_by_wavelength_is_that_of_the_ray() -> None:
    spectrum = {"wavelengths_nm": [400.0, 600.0, 700.0], "values": [0.3, 0.1, 0.0]}
    built = world(body((90.0, 90.0, 5.0), 1.5, absorption_per_mm=spectrum), wavelengths_nm=[450.0, 650.0])
    for wavelength, alpha in ((400.0, 0.3), (500.0, 0.2), (650.0, 0.05), (700.0, 0.0)):
        got = lf.trace(built, CENTRE + np.array([0.0, 0.0, 9.0]), [[0.0, 0.0, -1.0]], wavelength, split="transmit")
        np.testing.assert_allclose(got.weight, [fresnel(1.0, 1.5, 1.0)[1] ** 2 * np.exp(-5.0 * alpha)], rtol=1e-12)


def dense_camera(curved_side: str = "lens", absorbs: bool = True, **mla: Any) -> dict[str, Any]:
    """Return a camera whose lens, two cemented elements and a single one, and array are of catalogue glasses."""
    camera = close_up_camera()
    camera["lens"] = {"surfaces": [
        {"radius_mm": 25.0, "thickness_mm": 4.0, "glass": "SCHOTT/N-BAF10", "semi_diameter_mm": 6.0},
        {"radius_mm": -22.0, "thickness_mm": 1.5, "glass": DENSE, "semi_diameter_mm": 6.0},
        {"radius_mm": -90.0, "thickness_mm": 0.5, "semi_diameter_mm": 6.0},
        {"stop": True, "thickness_mm": 0.5, "semi_diameter_mm": 4.5},
        {"radius_mm": 60.0, "thickness_mm": 2.0, "glass": "SCHOTT/N-BK7", "semi_diameter_mm": 6.0, "conic": -0.5},
        {"radius_mm": np.inf, "semi_diameter_mm": 6.0},
    ]}  # fmt: skip
    camera["mla"] |= {"glass": DENSE, "curved_side": curved_side, "thickness_mm": 0.9} | mla
    del camera["mla"]["index"]
    return camera | {"absorption": absorbs}


def rays_into_the_lens(count: int, seed: int) -> tuple[Array, Array]:
    random = np.random.default_rng(seed)
    p = np.column_stack([random.uniform(-1.5, 1.5, (count, 2)), np.full(count, -60.0)])
    to = np.column_stack([random.uniform(-3.0, 3.0, (count, 2)), np.zeros(count)])
    return p, to - p


@pytest.mark.parametrize("curved_side", ["lens", "sensor"])
def test_a_camera_transmits_by_the_lengths_of_rays_in_its_glasses(curved_side: str) -> None:
    """Both engines; the lengths are those between the vertices of a camera that does not absorb."""
    scenes = [
        lf.Scene(camera=dense_camera(curved_side, absorbs), transport={"wavelengths_nm": [VIOLET_NM]})
        for absorbs in (False, True)
    ]
    clear, dyed = (lf.build(scene) for scene in scenes)
    p, d = rays_into_the_lens(300, 13)
    paths = lf.trace(clear, p, d, VIOLET_NM, split="transmit", record=True)
    glasses = [None, "SCHOTT/N-BAF10", DENSE, None, "SCHOTT/N-BK7", None, DENSE, None]
    alphas = np.array([absorption_per_mm(glass, VIOLET_NM) if glass else 0.0 for glass in glasses])
    whole = np.flatnonzero(paths.status == lf.Status.SENSOR)
    assert len(whole) > 150
    share = np.zeros(len(whole))
    for i, path in enumerate(whole):
        points = np.array([vertex.position for vertex in paths.vertices(path)])
        share[i] = np.exp(-alphas @ np.linalg.norm(np.diff(points, axis=0), axis=1))
    assert 0.02 < share.min() < share.max() < 0.8
    for engine in ("mesh", "sequential"):
        got = lf.trace(dyed, p, d, VIOLET_NM, split="transmit", engine=engine)
        arrived = got.status == lf.Status.SENSOR
        np.testing.assert_array_equal(got.source[arrived], paths.source[whole])
        np.testing.assert_allclose(got.weight[arrived] / paths.weight[whole], share, rtol=1e-12)
        assert abs(got.ledger.imbalance) < 1e-12
        names = [name for name in got.ledger.absorbed if name.startswith("inside ")]
        assert sorted(names) == ["inside lens[0]", "inside lens[1], mla", "inside lens[2]"]


def test_both_engines_enter_the_same_in_the_book() -> None:
    """Rays from all over, many of which end on mounts, on edges or between lenslets, and the lens is tilted."""
    camera = dense_camera() | {"pose": {"tilt_deg": [1.0, 2.0, 3.0]}}
    camera["lens"]["elements"] = [{"surfaces": [0, 1, 2], "pose": {"tilt_deg": [1.5, -1.0, 0.0]}}]
    dyed = lf.build(lf.Scene(camera=camera, transport={"wavelengths_nm": [VIOLET_NM]}))
    random = np.random.default_rng(14)
    p = np.column_stack([random.uniform(-9.0, 9.0, (2000, 2)), np.full(2000, -40.0)])
    to = np.column_stack([random.uniform(-6.0, 6.0, (2000, 2)), np.zeros(2000)])
    # The mesh engine follows light that total reflection turns off the image path, which the sequential one does not.
    mesh, blocks = (
        lf.trace(dyed, p, to - p, VIOLET_NM, split="transmit", engine=engine) for engine in ("mesh", "sequential")
    )
    _, a, b = np.intersect1d(mesh.source, blocks.source, return_indices=True)
    same = (mesh.events[a] == blocks.events[b]) & (np.abs(mesh.position[a] - blocks.position[b]).max(axis=1) < 1e-9)
    assert same.mean() > 0.95
    np.testing.assert_allclose(mesh.weight[a][same], blocks.weight[b][same], rtol=1e-11)
    some = mesh.source[a][same]
    ledgers = [
        lf.trace(dyed, p[some], (to - p)[some], VIOLET_NM, split="transmit", engine=engine).ledger
        for engine in ("mesh", "sequential")
    ]
    for name in ("inside lens[0]", "inside lens[1], mla", "inside lens[2]", "mla mount", "stop", "mla edge"):
        first, second = (ledger.absorbed.get(name, 0.0) for ledger in ledgers)
        assert abs(first - second) < 1e-9, name
        assert first > 0.0 or name == "mla edge"


def tank(alpha: float, lights: list[dict[str, Any]], glow: float = 0.0, **transport: Any) -> lf.Scene:
    """A chart and a wall that may glow in a tank of dyed water with dyed windows."""
    sheet = {"kind": "plane", "width_mm": 6.0, "height_mm": 5.0}
    return lf.Scene(
        camera=close_up_camera(12, 12) | {"focus_mm": 56.0},
        targets=[
            {"shape": sheet, "position_mm": [0, 0, -60.0], "material": {"reflectance": 0.8}},
            {"shape": sheet, "position_mm": [3.2, 0, -56.0], "rotation_deg": [0.0, 90.0, 0.0],
             "material": {"reflectance": 0.5, "radiance_w_m2_sr": glow}},
        ],
        tanks=[{
            "size_mm": [16.0, 14.0, 18.0], "wall_mm": 1.0, "position_mm": [0, 0, -54.0],
            "wall": {"index": 1.52, "absorption_per_mm": 5.0 * alpha},
            "liquid": {"index": 1.333, "absorption_per_mm": alpha},
        }],
        lights=lights,
        transport={"threads": 1, "split": "both"} | transport,
    )  # fmt: skip


def test_forward_equals_adjoint_in_dyed_water() -> None:
    """Welch's t-test on the sum of the picture, which sees the water of either leg: a third of the light each."""
    lamp = {"kind": "point", "position_mm": [4.0, -6.0, -30.0], "power_w": 1.0}
    sums, count = {}, 24
    for method, samples, first in (("adjoint", 48, 0), ("forward", 96, 10_000)):
        dyed = tank(0.03, [lamp], method=method, samples=samples, replicates=1)
        images = list(by_seed(dyed, range(first, first + count)))
        sums[method] = np.array([image.mean.sum() for image in images])
        for image in images:
            assert abs(image.ledger.imbalance) < 1e-12
            for ledger in (image.ledger, image.ledger.lamps):
                if ledger is not None:
                    assert ledger.absorbed["inside tanks[0] wall"] > 0.0
                    assert ledger.absorbed["inside tanks[0] liquid"] > 0.0
    error = np.hypot(*(each.std(ddof=1) / each.mean() for each in sums.values())) / np.sqrt(count)
    assert 3.0 * error < 0.2
    p = stats.ttest_ind(sums["adjoint"], sums["forward"], equal_var=False).pvalue
    assert p > LEVEL, {method: each.mean() for method, each in sums.items()}


def dyed_share(**changes: Any) -> float:
    """Return what 0.05 per mm of water leave of the light of a scene: the same samples with and without it."""
    images = [lf.render(tank(alpha, [], samples=32, replicates=1).changed(changes)) for alpha in (0.0, 0.05)]
    return float(images[1].mean.sum() / images[0].mean.sum())


def test_a_glow_in_dyed_water_is_seen_through_its_depth() -> None:
    """Between the shares of the shortest way and of a slant one."""
    share = dyed_share(**{
        "targets[0].material.radiance_w_m2_sr": 1.0, "targets[1].position_mm": [0, 0, -61.5],
        "targets[1].rotation_deg": [0, 0, 0], "transport.split": "transmit",
    })  # fmt: skip
    # 14 mm of water and a window of 1 mm; the camera sees it within 15 degrees in the water.
    straight = 0.05 * (60.0 - 46.0) + 0.25
    assert np.exp(-straight / np.cos(np.deg2rad(15.0))) < share < np.exp(-straight)


def test_a_glow_lights_others_through_dyed_water() -> None:
    """A small glowing sheet above the chart's middle: the light that the chart throws back has also come down to it."""
    seen = dyed_share(**{
        "targets[0].material.radiance_w_m2_sr": 1.0, "targets[0].material.reflectance": 0.0,
        "targets[0].shape": {"kind": "plane", "width_mm": 1.0, "height_mm": 1.0},
        "targets[1].position_mm": [0, 0, -61.5], "targets[1].rotation_deg": [0, 0, 0],
    })  # fmt: skip
    lit = dyed_share(**{
        "targets[0].shape": {"kind": "plane", "width_mm": 1.0, "height_mm": 1.0},
        "targets[1].material": {"radiance_w_m2_sr": 1.0, "reflectance": 0.0, "sides": "front"},
        "targets[1].shape": {"kind": "plane", "width_mm": 0.5, "height_mm": 0.5},
        "targets[1].position_mm": [4.0, 0, -57.0], "targets[1].rotation_deg": [0.0, -120.0, 0.0],
    })  # fmt: skip
    # From 3.5 to 5.4 mm between any two of their points, besides what the wall and its light meet at the window.
    assert np.exp(-0.05 * 5.8) < lit / seen < np.exp(-0.05 * 4.0)


@pytest.mark.long
def test_polarised_light_is_absorbed_alike() -> None:
    """A slab and the camera: the share of each packet, and not its state, is that of unpolarised light."""
    p, d = rays_into_the_lens(60, 15)
    states = []
    for absorbs in (False, True):
        slab = body((90.0, 90.0, 6.0), 1.6, (0.0, 40.0, 0.0), absorption_per_mm=0.1 if absorbs else 0.0)
        scene = lf.Scene(
            camera=dense_camera(absorbs=absorbs), targets=[slab | {"position_mm": [0.0, 0.0, -30.0]}],
            transport={"wavelengths_nm": [VIOLET_NM], "polarisation": True},
        )  # fmt: skip
        states.append(lf.trace(lf.build(scene), p, d, VIOLET_NM, split="transmit", stokes=[1.0, 0.6, 0.3, 0.5]))
    clear, dyed = states
    np.testing.assert_array_equal(clear.source, dyed.source)
    assert (dyed.weight < 0.6 * clear.weight).all()
    np.testing.assert_allclose(dyed.stokes / dyed.weight[:, None], clear.stokes / clear.weight[:, None], atol=1e-12)
