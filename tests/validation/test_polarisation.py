"""Polarised light through bodies, lenses and cameras against closed forms: Brewster, Fresnel's rhomb, Malus, plates.

The truth knows angles, indices and the layers (by `tmm`), and nothing of packets, frames and tables.
"""

import numpy as np
import pytest
from scipy import optimize, stats

import lfmesh as lf
from tests.cameras import camera_without_array, close_up_camera
from tests.renders import unchecked
from tests.validation.bodies import prism

tmm = pytest.importorskip("tmm")

WAVELENGTH = 587.6
LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds, all its comparisons together."""
COMPARISONS = 20

CAMERA = camera_without_array(pixels=20, pixel_mm=0.5)
FILM = {"film": {"layers": [{"index": 1.38, "thickness_nm": 90.0}, {"index": 2.1, "thickness_nm": 40.0}]}}
SUN = {"sun": {"layers": [{"index": 1.7, "extinction": 0.2, "thickness_nm": 60.0}]}}


def plate(path, thickness, angle, position, size=80.0, **glass):
    """A plate of glass, whose normal is the z axis turned about y."""
    u = np.array([np.cos(angle), -np.sin(angle)])
    n = np.array([np.sin(angle), np.cos(angle)])
    corners = [(-u, -n), (u, -n), (u, n), (-u, n)]
    outline = [0.5 * size * a + 0.5 * thickness * b for a, b in corners]
    return prism(path, outline, size, position, **glass)


def world(targets, camera=CAMERA, **scene):
    transport = {"polarisation": True, "wavelengths_nm": [WAVELENGTH]} | scene.pop("transport", {})
    return lf.build(lf.Scene(camera=camera, targets=targets, transport=transport, **scene))


def degree(stokes):
    """State of each packet: Q, U and V over I."""
    return stokes[:, 1:] / stokes[:, :1]


def test_light_reflected_at_brewsters_angle_is_completely_polarised(tmp_path):
    n = 1.5
    angle = np.arctan(n)
    glass = world([plate(tmp_path / "plate.obj", 10.0, 0.0, [0.0, 0.0, -200.0], index=n)])
    d = np.array([np.sin(angle), 0.0, -np.cos(angle)])
    start = [0.0, 0.0, -195.0] - 40.0 * d
    paths = lf.trace(glass, start, d, max_events=1, weight_cutoff=0.0)
    mirrored = paths.events == 1
    mirrored &= paths.direction[:, 2] > 0.0
    assert mirrored.sum() == 1
    r_s = (1.0 - n**2) / (1.0 + n**2)
    assert paths.weight[mirrored] == pytest.approx(0.5 * r_s**2, abs=1e-15)
    # The field is square to the plane of incidence.
    assert np.allclose(degree(paths.stokes)[mirrored], [1.0, 0.0, 0.0], rtol=0.0, atol=1e-12)
    assert np.allclose(np.abs(paths.reference[mirrored]), [0.0, 1.0, 0.0], rtol=0.0, atol=1e-12)
    # Of light in that plane nothing is reflected, and all of it passes the plate.
    paths = lf.trace(glass, start, d, max_events=9, weight_cutoff=0.0, stokes=[1.0, 1.0, 0.0, 0.0])
    assert paths.weight[paths.direction[:, 2] > 0.0].sum() < 1e-12
    assert paths.weight.max() == pytest.approx(1.0, abs=1e-12)


def referred(paths, axis):
    """Stokes vectors of packets with an axis square to their rays as the reference direction e."""
    d, e = paths.direction, paths.reference
    cosine, sine = e @ axis, np.cross(d, e) @ axis
    angle = 2.0 * np.arctan2(sine, cosine)
    i, q, u, v = paths.stokes.T
    return np.stack([i, np.cos(angle) * q + np.sin(angle) * u, np.cos(angle) * u - np.sin(angle) * q, v], axis=1)


def stokes_of(jones):
    """Stokes vector of the amplitudes along e and f, for fields that vary as exp(−iωt)."""
    e, f = jones
    product = np.conj(e) * f
    return np.array([abs(e) ** 2 + abs(f) ** 2, abs(e) ** 2 - abs(f) ** 2, 2.0 * product.real, 2.0 * product.imag])


X, Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def rhomb(path, angle, depth=37.0, **glass):
    """Fresnel's rhomb: light along −z is totally reflected at this angle at both of its long sides."""
    away = depth / np.tan(angle)
    outline = np.array([(20.0, 0.0), (20.0 - away, depth), (-away, depth), (0.0, 0.0)])
    return prism(path, outline, 30.0, [0.0, 0.0, -200.0], **glass)


def through_rhomb(glass, x, stokes):
    """Send light down the rhomb; return its Stokes vector behind it, with the reference direction x."""
    paths = lf.trace(
        glass, [x, 0.3, -100.0], [0.0, 0.0, -1.0], max_events=9, split="transmit", stokes=stokes, record=True
    )
    events = [vertex.event.name for vertex in paths.vertices(0)]
    assert events == ["START", "TRANSMITTED", "REFLECTED", "REFLECTED", "TRANSMITTED", "ESCAPED"]
    return referred(paths, X)[0]


def amplitudes_through_rhomb(n, angle, layers=()):
    """Amplitudes along x and y behind the rhomb of such in front of it, by tmm; scaled to power."""
    indices = [n, *(layer["index"] + 1j * layer.get("extinction", 0.0) for layer in layers[::-1])]
    thicknesses = [np.inf, *(layer["thickness_nm"] for layer in layers[::-1]), np.inf]
    found = []
    for each in "ps":
        # In the plane of incidence lies x.
        mirrored = tmm.coh_tmm(each, [*indices, 1.0], thicknesses, angle, WAVELENGTH)["r"]
        into = tmm.coh_tmm(each, [*indices, 1.0], thicknesses, 0.0, WAVELENGTH)["T"]
        found.append(mirrored**2 * into)
    return np.array(found)


def retardation(n, angle):
    """Phase by which total reflection parts s- and p-polarised light: Born & Wolf, 1.5.4."""
    return 2.0 * np.arctan(np.cos(angle) * np.sqrt(np.sin(angle) ** 2 - n**-2) / np.sin(angle) ** 2)


def test_fresnels_rhomb_turns_linear_into_circular_light_and_back(tmp_path):
    n = 1.51
    angle = optimize.brentq(lambda a: retardation(n, a) - np.pi / 4.0, np.radians(54.0), np.radians(57.0), xtol=1e-15)
    glass = world([rhomb(tmp_path / "rhomb.obj", angle, index=n)])
    both_faces = (4.0 * n / (n + 1.0) ** 2) ** 2
    for sign in (1.0, -1.0):
        # r_p leads r_s by an eighth of a wave at each reflection. With e = x, in the plane, and f = −y, U becomes V.
        found = through_rhomb(glass, -16.0, [1.0, 0.0, sign, 0.0])
        assert found == pytest.approx(both_faces * np.array([1.0, 0.0, 0.0, sign]), abs=1e-12)
        found = through_rhomb(glass, -16.0, [1.0, 0.0, 0.0, sign])
        assert found == pytest.approx(both_faces * np.array([1.0, 0.0, -sign, 0.0]), abs=1e-12)


def test_two_quarter_waves_of_total_reflection_reverse_circular_light(tmp_path):
    n = 2.6
    angle = optimize.brentq(lambda a: retardation(n, a) - np.pi / 2.0, np.radians(35.0), np.radians(41.0), xtol=1e-15)
    glass = world([rhomb(tmp_path / "half.obj", angle, depth=15.0, index=n)])
    found = through_rhomb(glass, -11.3, [1.0, 0.0, 0.6, 0.8])
    assert found / found[0] == pytest.approx([1.0, 0.0, -0.6, -0.8], abs=1e-12)


@pytest.mark.parametrize("coating", ["none", "film", "sun"])
def test_random_states_pass_the_rhomb_as_tmm_says(coating, tmp_path):
    n, angle = 1.6, np.radians(50.0)
    layers = {**FILM, **SUN}.get(coating, {"layers": []})["layers"]
    glass = world(
        [rhomb(tmp_path / "rhomb.obj", angle, index=n, coating=coating)], coatings={**FILM, **SUN}
    )  # fmt: skip
    jones, draw = amplitudes_through_rhomb(n, angle, layers), np.random.default_rng(4)
    for _ in range(10):
        sent = draw.normal(size=2) + 1j * draw.normal(size=2)
        found = through_rhomb(glass, -16.0, stokes_of(sent))
        # f = d × e is −y, and so are both amplitudes along it.
        assert found == pytest.approx(stokes_of(jones * sent), rel=1e-12, abs=1e-12)
        assert found[0] ** 2 == pytest.approx((found[1:] ** 2).sum(), rel=1e-12)


def on_axis(angle=None, **scene):
    """A camera with a polariser, and the rays of its axis with a state; the weight that arrives."""
    camera = CAMERA | ({"polariser_deg": angle} if angle is not None else {})
    return world([], camera, **scene)


def along_axis(built, stokes):
    paths = lf.trace(built, [0.0, 0.0, -100.0], [0.0, 0.0, 1.0], split="transmit", stokes=stokes)
    assert paths.body == ["sensor"]
    assert abs(paths.ledger.imbalance) < 1e-12
    return paths


def test_malus_law_holds_behind_a_lens():
    passed = along_axis(on_axis(), [1.0, 0.0, 0.0, 0.0]).weight[0]
    assert passed == pytest.approx((1.0 - 0.04) ** 2, abs=1e-12)
    for angle in (0.0, 20.0, 75.0, 90.0, 200.0):
        built = on_axis(angle)
        for psi in (0.0, 20.0, -70.0, 110.0):
            # The light goes along z, so that e = x and f = y.
            turn = np.radians(2.0 * psi)
            paths = along_axis(built, [1.0, np.cos(turn), np.sin(turn), 0.0])
            assert paths.weight[0] == pytest.approx(passed * np.cos(np.radians(psi - angle)) ** 2, abs=1e-12)
            taken = passed * np.sin(np.radians(psi - angle)) ** 2
            assert paths.ledger.absorbed.get("polariser", 0.0) == pytest.approx(taken, abs=1e-12)
        for stokes in ([1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, -1.0]):
            paths = along_axis(built, stokes)
            assert paths.weight[0] == pytest.approx(0.5 * passed, abs=1e-12)
            assert referred(paths, X)[0] == pytest.approx(
                0.5 * passed * np.array([1.0, np.cos(np.radians(2.0 * angle)), np.sin(np.radians(2.0 * angle)), 0.0]),
                abs=1e-12,
            )


def test_a_turned_camera_turns_its_polariser():
    built = world([], CAMERA | {"polariser_deg": 10.0, "pose": {"tilt_deg": [0.0, 0.0, 25.0]}})
    paths = along_axis(built, [1.0, np.cos(np.radians(70.0)), np.sin(np.radians(70.0)), 0.0])
    assert paths.weight[0] == pytest.approx(0.96**2, abs=1e-12)


@pytest.mark.parametrize("side", ["lens", "sensor"])
def test_an_array_keeps_the_handedness_of_light_whichever_way_it_looks(side):
    """The array's own frame is mirrored when its curved faces look at the sensor."""
    camera = close_up_camera()
    built = world([], camera | {"mla": camera["mla"] | {"curved_side": side}})
    draw = np.random.default_rng(6)
    start = np.stack([draw.uniform(-2.0, 2.0, 40), draw.uniform(-2.0, 2.0, 40), np.full(40, -60.0)], axis=1)
    d = np.array([0.0, 0.0, 1.0]) + draw.uniform(-0.05, 0.05, (40, 3)) * [1.0, 1.0, 0.0]
    paths = lf.trace(built, start, d, split="transmit", stokes=[1.0, 0.3, 0.5, 0.8])
    arrived = paths.status == lf.Status.SENSOR
    assert arrived.sum() > 10
    # Interfaces at small angles change a state by the squares of the angles only.
    found = np.array([row / row[0] for row in referred(paths, X)[arrived]])
    assert np.abs(found - [1.0, 0.3, 0.5, 0.8]).max() < 0.02
    # No interface turns part of completely polarised light into unpolarised light.
    found = lf.trace(built, start, d, split="both", weight_cutoff=1e-4, stokes=[1.0, 0.36, 0.48, 0.8]).stokes
    assert np.allclose(np.linalg.norm(found[:, 1:], axis=1), found[:, 0], rtol=1e-12, atol=0.0)


def tilted_glass(path):
    """Two tilted plates before a coated lens, the first of them coated."""
    return [
        plate(path / "first.obj", 3.0, 0.8, [0.0, 0.0, -60.0], index=1.7, coating="film"),
        plate(path / "second.obj", 4.0, -0.5, [0.0, 0.0, -160.0], size=60.0, index=1.5, coating="sun"),
    ]


def test_light_and_its_reverse_have_the_same_share(tmp_path):
    """What a polariser passes of any light equals what that light takes of the polarised ray that goes back."""
    surfaces = [dict(surface, coating="film") for surface in CAMERA["lens"]["surfaces"]]
    built = world(
        tilted_glass(tmp_path), CAMERA | {"lens": {"surfaces": surfaces}}, coatings={**FILM, **SUN},
    )  # fmt: skip
    draw, compared = np.random.default_rng(8), 0
    for _ in range(12):
        start, aim = np.append(draw.uniform(-5.0, 5.0, 2), -240.0), np.append(draw.uniform(-3.0, 3.0, 2), 0.0)
        sent = stokes_of(draw.normal(size=2) + 1j * draw.normal(size=2))
        sent[0] *= 1.3
        there = lf.trace(built, start, aim - start, split="transmit", stokes=sent)
        if there.status[0] != lf.Status.SENSOR:
            continue
        compared += 1
        axis = np.cross(there.direction[0], draw.normal(size=3))
        axis /= np.linalg.norm(axis)
        i, q, *_ = referred(there, axis)[0]
        # Backwards from just before the sensor.
        position = there.position[0] - 1e-3 * there.direction[0]
        back = lf.trace(
            built, position, -there.direction[0], split="transmit", stokes=[1.0, 1.0, 0.0, 0.0], reference=axis
        )
        assert back.body == ["escaped"]
        e = sent_reference((aim - start) / np.linalg.norm(aim - start))
        j = referred(back, e)[0]
        assert 0.5 * (i + q) == pytest.approx(0.5 * (j * sent) @ [1.0, 1.0, -1.0, 1.0], rel=1e-11)
    assert compared > 5


def sent_reference(d):
    """The part of the x axis that is square to a ray."""
    e = X - (X @ d) * d
    return e / np.linalg.norm(e)


def test_energy_closes_for_every_state_and_way_to_split(tmp_path):
    built = world(tilted_glass(tmp_path), coatings={**FILM, **SUN})
    draw = np.random.default_rng(9)
    start = np.column_stack([draw.uniform(-20.0, 20.0, (200, 2)), np.full(200, -240.0)])
    d = np.append(np.zeros(2), 1.0) + draw.uniform(-0.3, 0.3, (200, 3))
    states = np.array([stokes_of(draw.normal(size=2) + 1j * draw.normal(size=2)) for _ in start])
    states[:, 1:] *= draw.uniform(0.0, 1.0, (200, 1))
    for split in ("both", "roulette", "transmit"):
        paths = lf.trace(built, start, d, split=split, weight_cutoff=1e-3, stokes=states)
        assert abs(paths.ledger.imbalance) < 1e-12
        assert (paths.weight > 0.0).all()
        assert (np.linalg.norm(degree(paths.stokes), axis=1) <= 1.0 + 1e-12).all()
        assert np.abs((paths.reference * paths.direction).sum(axis=1)).max() < 1e-12


SEEN = {
    "shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": [0.0, 0.0, -150.0],
}  # fmt: skip
SHINING = SEEN | {"material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}
MATTE = SEEN | {"material": {"reflectance": 0.8}}


def rendered(targets, camera=CAMERA, **scene):
    transport = {
        "polarisation": True, "samples": 64, "replicates": 8, "split": "transmit", "wavelengths_nm": [WAVELENGTH],
    } | scene.pop("transport", {})  # fmt: skip
    return unchecked(lf.Scene(camera=camera, targets=targets, transport=transport, **scene))


def total(image):
    """Light of the whole image and its standard error, from the replicates' pixels, which are independent."""
    return image.mean.sum(), np.sqrt((image.stderr**2).sum())


def assert_equal(first, second, factor=1.0):
    """Compare two totals, the second times a factor, by a z-test at the level of all comparisons together."""
    (a, da), (b, db) = first, second
    z = (a - factor * b) / np.hypot(da, factor * db)
    assert abs(z) < stats.norm.isf(0.5 * LEVEL / COMPARISONS), z


@pytest.fixture(scope="module")
def brewster(tmp_path_factory):
    """A plate of glass at Brewster's angle before the camera; its plane of incidence holds the x axis."""
    path = tmp_path_factory.mktemp("brewster") / "plate.obj"
    return plate(path, 2.0, np.arctan(1.5), [0.0, 0.0, -60.0], size=120.0, index=1.5)


R_S = ((1.0 - 1.5**2) / (1.0 + 1.5**2)) ** 2
"""Share of s-polarised light that each face of this plate reflects; of the other nothing."""


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_a_plate_before_the_camera_polarises_what_it_sees(method, brewster):
    narrow = CAMERA | {"sensor": {"pixels": [4, 4], "pixel_mm": 0.5}}
    transport = {"method": method, "samples": 4096}
    images = [
        rendered([SHINING, brewster], narrow | {"polariser_deg": angle}, transport=transport) for angle in (0.0, 90.0)
    ]
    assert images[0].engine.startswith("mesh: transport.polarisation")
    assert all(abs(image.ledger.imbalance) < 1e-12 for image in images)
    # The field along x lies in the plane of incidence. Over the small field of view the shares change in proportion to
    # the angle, and their means by its square, some 1e-3.
    along, across = map(total, images)
    assert across[0] / along[0] == pytest.approx((1.0 - R_S) ** 2, rel=0.01)


@pytest.mark.parametrize("angle", [0.0, 90.0])
def test_forward_equals_adjoint_with_reflections_and_a_polariser(angle, brewster):
    camera = CAMERA | {"polariser_deg": angle}
    transport = {"split": "both", "samples": 64}
    images = [rendered([SHINING, brewster], camera, transport=transport | {"method": each}) for each in METHODS]
    assert_equal(*map(total, images))


METHODS = ("adjoint", "forward")
LAMP = {"kind": "directional", "direction": [0.3, 0.2, -1.0], "irradiance_w_m2": 1.0}


@pytest.mark.parametrize("method", METHODS)
def test_a_matte_target_sends_unpolarised_light_whatever_lights_it(method):
    transport = {"method": method}
    scalar = lf.render(
        lf.Scene(camera=CAMERA, targets=[MATTE], lights=[LAMP], transport={
            "method": method, "samples": 64, "replicates": 8, "split": "transmit", "wavelengths_nm": [WAVELENGTH],
        })
    )  # fmt: skip
    for state in (None, {"kind": "linear", "angle_deg": 20.0}, {"kind": "circular"}):
        lamp = LAMP if state is None else LAMP | {"polarisation": state}
        whole = rendered([MATTE], lights=[lamp], transport=transport)
        assert_equal(total(whole), total(scalar))
        half = rendered([MATTE], CAMERA | {"polariser_deg": 35.0}, lights=[lamp], transport=transport)
        assert_equal(total(half), total(scalar), 0.5)


@pytest.mark.parametrize("method", METHODS)
def test_a_plate_before_a_lamp_passes_what_its_polarisation_lets_through(method, tmp_path):
    """A small matte target in the shadow of a plate at Brewster's angle to the light."""
    tilt = np.radians(50.0)
    d = np.array([-np.sin(tilt), 0.0, -np.cos(tilt)])
    centre = [0.0, 0.0, -150.0] - 60.0 * d
    glass = plate(tmp_path / "plate.obj", 2.0, tilt + np.arctan(1.5), centre, size=50.0, index=1.5)
    target = MATTE | {"shape": {"kind": "plane", "width_mm": 10.0, "height_mm": 10.0}}
    lamp = LAMP | {"direction": d.tolist()}

    def light(state):
        return total(
            rendered(
                [target, glass], lights=[lamp | ({"polarisation": state} if state else {})],
                transport={"method": method, "split": "both", "samples": 256 if method == "adjoint" else 512},
            )
        )  # fmt: skip

    # The x axis lies in the plane of incidence.
    p = light({"kind": "linear", "angle_deg": 0.0})
    assert p[1] < 0.03 * p[0]
    passed = (1.0 - R_S) / (1.0 + R_S)
    assert_equal(light({"kind": "linear", "angle_deg": 90.0}), p, passed)
    for state in (None, {"kind": "circular", "handedness": "left"}):
        assert_equal(light(state), p, 0.5 * (1.0 + passed))


def test_states_stay_sound_where_the_plane_of_incidence_is_hardly_defined(tmp_path):
    """Rays along the normal to rounding, along the surface, and about the critical angle, from inside and outside."""
    n = 1.5
    glass = world([plate(tmp_path / "plate.obj", 10.0, 0.0, [0.0, 0.0, -200.0], index=n)])
    critical = np.arcsin(1.0 / n)
    near = [0.0, 1e-300, 1e-17, 1e-12, 1e-9, 1e-5]
    angles = [*near, *(0.5 * np.pi - np.array([1e-12, 1e-9, 1e-5, 1e-2]))]
    angles += [critical + sign * size for sign in (-1.0, 1.0) for size in near[2:]]
    draw = np.random.default_rng(11)
    azimuths = draw.uniform(0.0, 2.0 * np.pi, len(angles))
    d = np.column_stack(
        [np.sin(angles) * np.cos(azimuths), np.sin(angles) * np.sin(azimuths), -np.cos(angles)]
    )  # fmt: skip
    states = np.array([stokes_of(draw.normal(size=2) + 1j * draw.normal(size=2)) for _ in angles])
    for start in ([0.1, 0.2, -195.0 + 1e-6], [0.1, 0.2, -199.0]):
        paths = lf.trace(glass, np.tile(start, (len(d), 1)), d, max_events=4, weight_cutoff=0.0, stokes=states)
        assert abs(paths.ledger.imbalance) < 1e-12
        kept = paths.weight > 0.0
        assert np.isfinite(paths.stokes).all()
        assert np.isfinite(paths.reference).all()
        assert np.allclose(np.linalg.norm(degree(paths.stokes[kept]), axis=1), 1.0, rtol=0.0, atol=1e-12)
        assert np.abs((paths.reference * paths.direction).sum(axis=1))[kept].max() < 1e-12
        # Through both faces along the normal a state stays as it is.
        along = np.flatnonzero((paths.source < 4) & (paths.events == (2 if start[2] > -195.0 else 1)))
        along = along[paths.direction[along, 2] < 0.0]
        assert len(along) == 4
        found = referred(paths, X)[along]
        assert found / found[:, :1] == pytest.approx(states[:4] / states[:4, :1], abs=1e-11)
