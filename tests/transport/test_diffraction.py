"""Diffraction at lenslets: white pictures against closed forms, and all ways to render against each other."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import j1

import lfmesh as lf
from lfmesh.scene import Camera, Lens, MicrolensArray, Scene, Sensor, Surface, Transport
from lfmesh.transport.aims.fitting import ALLOWED
from lfmesh.transport.aims.support import beyond_sensor_aim
from lfmesh.transport.sequences.stop_rays import CameraTables, Reach, rays_from_stop
from tests.instances import instances

LEVEL = 1e-5
"""Of each test, at which it fails by chance."""

NM = 550.0
Array = np.ndarray[Any, Any]


def camera(
    focal_mm: float = 2.5, pitch_mm: float = 0.14, pixel_mm: float = 0.014, *, across: int = 61, away_mm: float = 4e4,
    f_number: float | None = None, pixels: int | None = None, at_mm: float = 1e7, cover: bool = False,
    mla: dict[str, Any] | None = None, **transport: Any,
) -> Scene:  # fmt: skip
    """An ideal thin lens far before an array, through which the lenslets see a bright disk that fills their field."""
    semi = 0.5 * away_mm / (f_number or focal_mm / pitch_mm)
    wide = pixels or round(pitch_mm / pixel_mm)
    radius = 0.75 * across * pitch_mm / away_mm * at_mm + 1.5 * semi
    return Scene(
        camera=Camera(
            lens=Lens(
                surfaces=(Surface(paraxial=True, focal_length_mm=away_mm, semi_diameter_mm=semi, stop=True),)
            ),
            mla=MicrolensArray(
                **{
                    "count": (across, across), "pitch_mm": pitch_mm, "focal_length_mm": focal_mm, "index": 1.5,
                    "thickness_mm": 0.02, "distance_mm": away_mm, **(mla or {}),
                }
            ),
            sensor=Sensor(
                pixels=(wide, wide), pixel_mm=pixel_mm,
                **({"cover": {"thickness_mm": 0.3, "index": 1.5}} if cover else {}),
            ),
        ),
        targets=[
            {
                "shape": {"kind": "disk", "radius_mm": radius},
                "position_mm": (0.0, 0.0, -at_mm),
                "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
            }
        ],
        transport=Transport(
            **{"diffraction": "lenslets", "split": "transmit", "wavelengths_nm": (NM,), "threads": 1, **transport}
        ),
    )  # fmt: skip


def white_picture(
    focal_mm: float, pitch_mm: float, pixels: int, pupil: float, *, clear_mm: float | None = None, nm: float = NM
) -> Array:
    """Share of a lenslet's light by pixel, (n, n), behind many squares, or circles, that all show a round pupil.

    The pupil's image, a disk of `pupil` pitches, convolved with the aperture's pattern, summed over all lenslets. That
    is a Fourier series over the pitch, which ends where the aperture's overlap with itself does.
    """
    m = np.arange(-60, 61)
    shift = np.abs(m) * nm * 1e-6 * focal_mm / (pitch_mm * (clear_mm or pitch_mm))
    if clear_mm is None:
        triangle = np.clip(1.0 - shift, 0.0, None)
        overlap = triangle[:, None] * triangle
    else:
        part = np.minimum(np.hypot(shift[:, None], shift), 1.0)
        overlap = 2.0 / np.pi * (np.arccos(part) - part * np.sqrt(1.0 - part**2))
    x = np.pi * pupil * np.hypot(m[:, None], m)
    disk = np.divide(2.0 * j1(x), x, out=np.ones_like(x), where=x > 0.0)
    wave = np.exp(2j * np.pi * np.outer((np.arange(pixels) - 0.5 * (pixels - 1)) / pixels, m))
    box = np.sinc(m / pixels)
    return (wave @ (disk * overlap * box[:, None] * box) @ wave.T).real / pixels**2


CASES = {
    "A": ({"focal_mm": 2.5, "pixel_mm": 0.014, "f_number": 20.0}, (7.062, 15.18, 15.62, 15.75, 15.79), 0.21),
    "D": (
        {"focal_mm": 5.6, "pixel_mm": 0.010, "f_number": 40.0},
        (5.773, 6.141, 6.31, 6.361, 6.408, 6.426, 6.438),
        0.5525,
    ),
}
"""Cameras of the Fresnel numbers of lenslets of 14 µm with f = 25 and 56 µm and pixels of 1.4 and 1 µm behind lenses of
f/2 and f/4, ten times slower, and what a prototype found: a thousandth of the light on the pixels of the middle row,
and in the corner, without light of distant lenslets, which is 0.04 to 0.06 in each pixel."""

FAR = 0.065
"""Thousandths of the light that the prototype left out on a pixel, at most."""


def sums(pixels: Array) -> Array:
    """Return sums of pixels, five across a lenslet: by column, by row, by place across lenslets, of all."""
    across, along = pixels.sum(axis=0), pixels.sum(axis=1)
    places = [each.reshape(-1, 5).sum(axis=0) for each in (across, along)]
    return np.concatenate([across, along, *places, [pixels.sum()]])


def agrees(first: lf.Image, second: lf.Image) -> bool:
    """Compare the sums of two images by Welch's t-tests with a bound for the worst (Bonferroni).

    Light that does not diffract would be seen, at 7.8 sigma; by single pixels, known to 6 %, it would not.
    """
    variance = sums(first.error[..., 0] ** 2) + sums(second.error[..., 0] ** 2)
    both = variance > 0.0
    t = np.abs(sums(first.mean[..., 0]) - sums(second.mean[..., 0]))[both] / np.sqrt(variance[both])
    freedom = min(first.replicates, second.replicates) - 1
    return bool(2.0 * stats.t.sf(t.max(), freedom) * t.size > LEVEL)


BY_ENGINE = [("A", "sequential"), ("A", "mesh"), ("D", "sequential"), ("D", "mesh")]


@pytest.mark.parametrize("case_by_engine", instances(BY_ENGINE, long=[("A", "sequential"), ("D", "mesh")]))
def test_a_white_picture_is_the_pupil_blurred_by_the_apertures_pattern(case_by_engine: tuple[str, str]) -> None:
    case, engine = case_by_engine
    given, printed, corner = CASES[case]
    scene = camera(**given, engine=engine, samples=12_800, replicates=64)
    image = lf.render(scene)
    pixels = scene.camera.sensor.pixels[0]
    pupil = given["focal_mm"] / given["f_number"] / 0.14
    truth = white_picture(given["focal_mm"], 0.14, pixels, pupil)
    assert truth.sum() == pytest.approx(1.0, rel=1e-9)
    row = 1e3 * truth[pixels // 2, : pixels // 2]
    assert np.all((row - printed > 0.0) & (row - printed < FAR))
    assert 0.0 < 1e3 * truth[0, 0] - corner < FAR
    assert shows(image, truth)
    # The light itself: that of a geometric camera, but for what runs beyond a right angle.
    plain = lf.render(scene.changed({"transport.diffraction": "none"}))
    assert image.mean.sum() == pytest.approx(plain.mean.sum(), rel=3e-3)
    assert abs(image.ledger.imbalance) < 1e-12


@pytest.mark.parametrize("engine", instances(["sequential", "mesh"], long=["mesh"]))
def test_between_small_micro_images_lies_what_lenslets_throw_there(engine: str) -> None:
    """The pupil's image is a fifth of a pitch wide: most pixels have diffracted light alone."""
    scene = camera(5.6, pixel_mm=0.01, f_number=200.0, engine=engine, samples=3200, replicates=32)
    image, truth = lf.render(scene), white_picture(5.6, 0.14, 14, 0.2)
    assert shows(image, truth)
    # Each ray of a uniform surround comes through some lenslet, but for what runs beyond a right angle.
    expected = 0.96**2 * math.pi * (0.5 / 200.0) ** 2 * 0.14**2 * 1e-6
    assert image.mean.sum() == pytest.approx(expected, abs=4.0 * math.hypot(*image.error.ravel()))
    assert math.hypot(*image.error.ravel()) < 0.01 * expected
    proof = lf.build(scene).aim_proof
    assert proof is not None
    assert proof.holds


@pytest.mark.parametrize("engine", instances(["sequential", "mesh"], long=["mesh"]))
def test_round_apertures_show_the_pupil_blurred_by_airys_pattern(engine: str) -> None:
    given, _, _ = CASES["D"]
    mla = {"clear_diameter_mm": 0.126}
    scene = camera(**given, mla=mla, engine=engine, samples=3200, replicates=64)
    image = lf.render(scene)
    assert shows(image, white_picture(5.6, 0.14, 14, 1.0, clear_mm=0.126))
    assert not shows(image, white_picture(5.6, 0.14, 14, 1.0))
    # Circles pass π/4 (D/p)² of what squares do.
    whole = lf.render(camera(**given, samples=800, replicates=64))
    share, error = image.mean.sum() / whole.mean.sum(), 4.5 * np.hypot(image.error, whole.error).max() * 14 * 2
    assert share == pytest.approx(0.25 * np.pi * 0.9**2, abs=error / whole.mean.sum() + 1e-3)
    assert abs(image.ledger.imbalance) < 1e-12


TWO_FACES = {"focal_length_mm": None, "radius_mm": 1.2564, "back": {"radius_mm": 50.0}, "thickness_mm": 3.0}
"""A thick lens of f = 2.5 mm, whose focus is 0.51 mm behind it."""


def test_thick_lenslets_diffract_at_their_front_by_their_focal_length() -> None:
    """Light narrows in the plate, so that the first face limits it; a change there moves it by f on the sensor."""
    image = lf.render(camera(f_number=30.0, pixel_mm=0.01, mla=TWO_FACES, samples=25_600, replicates=32))
    # In sums over columns, as corners are dark.
    mean, error = image.mean.reshape(14, 14).sum(axis=0), np.sqrt((image.error.reshape(14, 14) ** 2).sum(axis=0))

    def worst(lever_mm: float) -> float:
        truth = white_picture(lever_mm, 0.14, 14, 2.5 / 30.0 / 0.14).sum(axis=0)
        return float((np.abs(mean - mean.sum() * truth) / error).max())

    assert 2.0 * stats.norm.sf(worst(2.5)) * len(mean) > LEVEL
    # At the second face it would be moved by the distance from there alone.
    assert worst(0.51) > 15.0
    assert abs(image.ledger.imbalance) < 1e-12


MATCHED = [("A", 20.0), ("D", 40.0)]
SLOWER = [("A", 60.0), ("D", 80.0)]


@pytest.mark.parametrize("camera_of", instances(MATCHED + SLOWER, long=[*MATCHED, ("A", 60.0)]))
def test_a_white_picture_is_the_sum_of_point_spreads(camera_of: tuple[str, float]) -> None:
    """Of points in focus, evenly over what a lenslet of glass shows of them, by waves that interfere between lenslets.

    The lens passes no finer detail than λ N, so that eight points a lenslet, at f/40, are as good as all. Points that
    mirror each other stand for one, and light on other lenslets for that of other points on this one. Without
    diffraction 5 % of the light and more would lie elsewhere.
    """
    case, f_number = camera_of
    given, _, _ = CASES[case]
    pitch, away, at, wide = 0.14, 4e4, 1e7, round(0.14 / given["pixel_mm"])
    image, focal = 1.0 / (1.0 / away - 1.0 / at), given["focal_mm"]
    scene = camera(**{**given, "f_number": f_number}, across=21, mla={"distance_mm": image}, pixels=9 * wide)
    count = 2 * math.ceil(160.0 / f_number)
    found, places = np.zeros((wide, wide)), (np.arange(count // 2) + 0.5) / count * pitch * at / image
    for i, x in enumerate(places):
        for j, y in enumerate(places[: i + 1]):
            spread = lf.point_spread(scene, (x, y, -at), tolerance=0.02).mean.reshape(9, wide, 9, wide).sum(axis=(0, 2))
            four = sum(spread[::up, ::left] for up in (1, -1) for left in (1, -1))
            found += four if i == j else four + four.T
    found /= found.sum()
    truth, plain = (
        white_picture(focal, pitch, wide, focal * away / (f_number * image * pitch), nm=nm) for nm in (NM, 1e-3)
    )
    assert np.abs(found - truth).sum() < 0.01
    assert np.abs(found - plain).sum() > 0.05
    row, expected = found[wide // 2], truth[wide // 2]
    lit = expected > 0.5 * expected.max()
    assert row[lit] == pytest.approx(expected[lit], rel=0.015)


def shows(image: lf.Image, truth: Array, channel: int = 0) -> bool:
    """Compare a wavelength with the truth up to a factor by t-tests of all pixels with a bound for the worst."""
    mean, error = image.mean[:, :, channel], image.error[:, :, channel]
    scale = (mean * truth / error**2).sum() / (truth**2 / error**2).sum()
    t = np.abs(mean - scale * truth) / error
    return bool(2.0 * stats.t.sf(t.max(), image.replicates - 1) * t.size > LEVEL)


def test_geometric_optics_is_far_from_that() -> None:
    """The white picture's test would fail without the change of direction."""
    given, _, _ = CASES["D"]
    image = lf.render(camera(**given, samples=256, diffraction="none"))
    share = image.mean.reshape(14, 14) / image.mean.sum()
    assert np.abs(share - white_picture(5.6, 0.14, 14, 1.0)).sum() > 0.05


SMALL = {
    "square": {},
    "hexagonal": {"layout": "hexagonal"},
    "towards the sensor": {"curved_side": "sensor"},
    "cylinders": {"cylinder_axis": "y"},
    "round": {"clear_diameter_mm": 0.013},
    "round, on the sensor's side": {"clear_diameter_mm": 0.012, "curved_side": "sensor", "layout": "hexagonal"},
    "two faces": {"focal_length_mm": None, "radius_mm": 0.025, "back": {"radius_mm": 0.025}},
    "two faces, the second one round": {
        "focal_length_mm": None, "radius_mm": 0.025, "curved_side": "sensor", "back": {"radius_mm": 0.025},
        "clear_diameter_mm": 0.009,
    },
}  # fmt: skip

PLAIN = ["square", "hexagonal", "towards the sensor", "round"]
"""Each of these is a part of one of the others."""


def real_size(mla: dict[str, Any], **transport: Any) -> Scene:
    """Seven lenslets of 14 µm across before 30 pixels of 2.8 µm, with a disk that lights half of them."""
    return camera(
        0.025, 0.014, 0.0028, across=7, away_mm=4.0, f_number=2.0, pixels=35, at_mm=400.0,
        mla={"thickness_mm": 0.006, **mla}, replicates=32, **transport,
    )  # fmt: skip


TWO = ["two faces", "two faces, the second one round"]


@pytest.mark.parametrize("kind", instances(SMALL, long=[*PLAIN, *TWO, "cylinders"]))
def test_forward_equals_adjoint_behind_small_lenslets(kind: str) -> None:
    adjoint = lf.render(real_size(SMALL[kind], samples=512))
    forward = lf.render(real_size(SMALL[kind], samples=3000, method="forward"))
    assert adjoint.mean.sum() > 0.0
    assert agrees(adjoint, forward)
    for image in (adjoint, forward):
        assert abs(image.ledger.imbalance) < 1e-12


@pytest.mark.parametrize("kind", instances(SMALL, long=[*PLAIN, "cylinders", "two faces"]))
def test_the_mesh_engine_equals_the_sequential_one(kind: str) -> None:
    """Both draw the same changes from a packet's key, which another wavelength makes other ones."""
    images = [lf.render(real_size(SMALL[kind], samples=64, engine=engine)) for engine in ("mesh", "sequential")]
    assert images[0].mean == pytest.approx(images[1].mean, rel=1e-9, abs=1e-9 * images[1].mean.max())
    other = lf.render(real_size(SMALL[kind], samples=64, wavelengths_nm=(0.9 * NM,)))
    assert not np.allclose(other.mean, images[1].mean, rtol=1e-3, atol=0.0)


@pytest.mark.long
@pytest.mark.parametrize("split", ["both", "roulette"])
def test_reflections_diffract_alike_both_ways(split: str) -> None:
    adjoint = lf.render(real_size({}, samples=512, split=split))
    forward = lf.render(real_size({}, samples=3000, split=split, method="forward"))
    assert agrees(adjoint, forward)
    for image in (adjoint, forward):
        assert abs(image.ledger.imbalance) < 1e-12


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"camera.mla": None}, "needs camera.mla"),
        ({"camera.mla.curved_finish": "diffuse"}, "needs a polished array"),
        ({"transport.polarisation": True}, "is not traced for polarised light"),
    ],
)
def test_what_is_not_followed_is_refused(changed: dict[str, Any], words: str) -> None:
    scene = camera(across=3).changed({"transport.diffraction": "none"})
    with pytest.raises(lf.LfmeshError, match=words):
        scene.changed({**changed, "transport.diffraction": "lenslets"})


@pytest.mark.parametrize(
    ("changed", "words"),
    [({"clear_diameter_mm": 0.141}, "at most pitch_mm = 0.14"), ({"cylinder_axis": "x"}, "cylinders have no round")],
)
def test_apertures_that_are_no_circles_are_refused(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(lf.LfmeshError, match=words):
        camera(across=3, mla={"clear_diameter_mm": 0.1, **changed})


def test_round_apertures_widen_airy_disks() -> None:
    whole, narrow = (lf.first_order(camera(across=3, mla=mla)) for mla in ({}, {"clear_diameter_mm": 0.07}))
    assert narrow.microlens_airy_disk_px == pytest.approx(2.0 * (whole.microlens_airy_disk_px or 0.0))
    assert narrow.microlens_fresnel_number == pytest.approx((whole.microlens_fresnel_number or 0.0) / 4.0)
    assert narrow.microlens_f_number == whole.microlens_f_number


def test_the_sequential_engine_refuses_given_rays_that_diffract() -> None:
    world = lf.build(camera(across=3))
    with pytest.raises(lf.LfmeshError, match="deflects light packet by packet"):
        lf.trace(world, [[0.0, 0.0, -1.0]], [[0.0, 0.0, 1.0]], engine="sequential", split="transmit")


def test_check_names_the_key_and_is_silent_with_it() -> None:
    facts = lf.first_order(camera(5.6, 0.14, 0.010, f_number=40.0, diffraction="none"))
    assert facts.microlens_fresnel_number == pytest.approx(1.591, abs=1e-3)
    assert any('take transport.diffraction = "lenslets"' in line for line in facts.warnings)
    facts = lf.first_order(camera(5.6, 0.14, 0.010, f_number=40.0))
    assert not any("microlenses' Airy disk" in line for line in facts.warnings)


@pytest.mark.parametrize("kind", SMALL)
def test_the_aim_holds_the_diffracted_light_but_for_far_changes_of_direction(kind: str) -> None:
    world = lf.build(real_size(SMALL[kind]))
    proof = world.aim_proof
    assert proof is not None
    assert proof.diffracted is not None
    assert proof.holds
    assert not proof.fallback
    tables, random = world.tables, np.random.default_rng(7)
    through = CameraTables(tables.lens, tables.mla, tables.sensor, tables.frames)
    draws = [rays_from_stop(through, Reach(0.05), random) for _ in range(8)]
    held = [beyond_sensor_aim(world.aim, through, rays) <= 1.0 for rays in draws]
    unmoved = [
        beyond_sensor_aim(world.aim, through, rays._replace(kick=np.zeros_like(rays.kick))) <= 1.0 for rays in draws
    ]
    # Aimed as if rays had not changed their directions, far more of them would lie outside.
    missed = sum(np.count_nonzero(~inside) for inside in held)
    assert missed < 0.2 * sum(np.count_nonzero(~inside) for inside in unmoved)
    # Rays of its own tell the share better than the proof's, of which one or three lie outside.
    shares = [rays.throughput[~inside].sum() / rays.throughput.sum() for rays, inside in zip(draws, held, strict=True)]
    assert np.mean(shares) + 3.0 * np.std(shares, ddof=1) / np.sqrt(8.0) < ALLOWED


def spread_of_samples(each: int, replicates: int) -> float:
    """Return the variance of lit pixels over their squared mean, by replicates of some samples a pixel, times these."""
    image = lf.render(real_size({}, samples=each * replicates).changed({"transport.replicates": replicates}))
    lit = image.mean > 0.3 * image.mean.max()
    return float((image.stderr[lit] ** 2 / image.mean[lit] ** 2).mean()) * each * replicates


def test_samples_of_a_pixel_change_their_directions_evenly_and_none_is_heavy() -> None:
    """A white picture's 1,000 pixels by 32 replicates: the mean of their variances has an error of 0.8 %.

    Of random changes, each sample that misses the opening or meets it would have as much as one alone, for any number
    of samples.
    """
    alone, together = spread_of_samples(1, 32), spread_of_samples(64, 32)
    assert alone < 1.0
    assert together < 0.8 * alone


def test_two_wavelengths_are_each_blurred_by_their_own_pattern() -> None:
    """Of one run, whose rays share random numbers: 450 nm spreads half as far as 900 nm."""
    given, _, _ = CASES["A"]
    nm = (450.0, 900.0)
    image = lf.render(camera(**given, samples=1600, replicates=64, wavelengths_nm=nm))
    pupil = given["focal_mm"] / given["f_number"] / 0.14
    truths = [white_picture(given["focal_mm"], 0.14, 10, pupil, nm=each) for each in nm]
    for channel in range(2):
        assert shows(image, truths[channel], channel)
        assert not shows(image, truths[1 - channel], channel)


@pytest.mark.parametrize("f_number", [11.0, 16.0])
def test_light_behind_a_lenslet_falls_with_the_square_of_the_f_number(f_number: float) -> None:
    """By π L / (4 N² + 1) on the axis, from f/8 on, lens and lenslets alike: neighbours bring what a lenslet loses."""
    bright, dark = (lf.render(camera(0.14 * number, samples=800, replicates=32)) for number in (8.0, f_number))
    wanted = (4.0 * 8.0**2 + 1.0) / (4.0 * f_number**2 + 1.0)
    found = dark.mean.sum() / bright.mean.sum()
    error = np.hypot(*(np.sqrt((image.stderr**2).sum()) / image.mean.sum() for image in (bright, dark)))
    assert error < 0.005
    assert abs(found / wanted - 1.0) < 4.5 * error
