"""Particles against bundles of rays that are traced from their places one by one, and against each other's methods."""

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.transport.render.parts import parts_of
from tests.cameras import bench_camera
from tests.frames import motion
from tests.instances import instances
from tests.renders import by_seed

PLACES = [(3.0, -2.0, -455.0), (-6.5, 4.0, -520.0), (0.7, 7.1, -610.0)]
"""Before the plane in focus, and behind it, so that each lights several lenslets."""

PIXELS = 160
MICRO_IMAGE = 10
RAYS = 200_000
LATTICE = 640
"""Rays along a side of the stop, where they are even."""

LEVEL = 1e-3
"""Of all comparisons of a test together, after Bonferroni."""


def scene_of(points, tmp_path, **transport):
    path = tmp_path / "particles.csv"
    rows = "".join(f"{x},{y},{z},{w}\n" for (x, y, z), w in points)
    path.write_text("x_mm,y_mm,z_mm,intensity_w_sr\n" + rows)
    text = (
        bench_camera(16, 16)
        + """
[[particles]]
file = "particles.csv"
samples = 32768
[transport]
samples = 8
replicates = 8
split = "transmit"
"""
    )
    return lf.loads(text, tmp_path).changed({f"transport.{key}": value for key, value in transport.items()})


def bundle(scene, place, intensity):
    """Return power and number of rays by pixel, of random rays from a point to all of the lens."""
    draw = np.random.default_rng(5)
    # Of the lens only its front disk of 8 mm radius, in the plane z = 0, lets light in.
    r, phi = 8.2 * np.sqrt(draw.random(RAYS)), 2.0 * np.pi * draw.random(RAYS)
    return traced(scene, place, intensity, r * np.cos(phi), r * np.sin(phi), np.pi * 8.2**2 / RAYS)


def even_bundle(scene, place, intensity):
    """Return what `bundle` does, of rays through the squares of a lattice over the stop, of 5 mm radius in z = 0."""
    side = 10.4 / LATTICE
    x, y = np.meshgrid(*[side * (np.arange(LATTICE) + 0.5) - 5.2] * 2)
    inside = np.hypot(x, y) < 5.2
    return traced(scene, place, intensity, x[inside], y[inside], side**2)


def traced(scene, place, intensity, x, y, area):
    """Return power and number of rays by pixel, of rays from a point to points (x, y, 0), traced by the meshes."""
    world = lf.build(scene.changed({"transport.engine": "mesh"}))
    place = np.array(place)
    way = np.stack([x, y, np.zeros_like(x)], axis=1) - place
    length = np.linalg.norm(way, axis=1)
    paths = lf.trace(world, np.tile(place, (len(way), 1)), way / length[:, None], split="transmit")
    # dω = cos dA / distance²
    power = intensity * area * -place[2] / length**3
    fell = paths.status == lf.Status.SENSOR
    at = frame.points(motion(world, "world", "sensor"), paths.position[fell])
    pitch = scene.camera.sensor.pixel_mm
    columns, rows = (np.floor(at[:, axis] / pitch + 0.5 * PIXELS).astype(int) for axis in (0, 1))
    image = np.zeros((2, PIXELS, PIXELS))
    np.add.at(image[0], (rows, columns), (paths.weight * power[paths.source])[fell])
    np.add.at(image[1], (rows, columns), 1.0)
    return image


COMPARED = len(PLACES) + 1
"""Places of particles, one of them behind a window too."""


def micro_images(image):
    """Return the power and the centre of light, in pixels, of each square of pixels behind a lenslet."""
    n = PIXELS // MICRO_IMAGE
    cells = image.reshape(n, MICRO_IMAGE, n, MICRO_IMAGE).transpose(0, 2, 1, 3)
    power = cells.sum(axis=(2, 3))
    across = np.arange(MICRO_IMAGE)
    with np.errstate(invalid="ignore"):
        return power, np.stack(
            [(cells.sum(axis=2) * across).sum(axis=2) / power, (cells.sum(axis=3) * across).sum(axis=2) / power]
        )


WINDOW = {"refractor": {"box_mm": (200.0, 200.0, 12.0), "index": 1.5}, "position_mm": (0.0, 0.0, -300.0),
          "rotation_deg": (15.0, -20.0, 0.0)}  # fmt: skip


@pytest.mark.parametrize(("place", "window"), [*[(place, ()) for place in PLACES], (PLACES[1], (WINDOW,))])
def test_centres_of_light_are_those_of_a_traced_bundle(place, window, tmp_path):
    """In every micro-image that holds a hundredth of the light, to 0.05 pixels; its power by a z-test.

    Through a thick, tilted window too, which shifts the light by some millimetres.
    """
    scene = scene_of([(place, 2.5)], tmp_path).changed({"targets": window})
    if window:
        # Glass leaves the aim a tenth of its packets.
        scene = scene.changed({"particles[0].samples": 1 << 19})
    image = lf.render(scene)
    truth, rays = bundle(scene, place, 2.5)
    power, centre = micro_images(image.mean[..., 0])
    true_power, true_centre = micro_images(truth)
    lit = true_power > (0.1 if window else 0.01) * true_power.sum()
    assert lit.sum() >= 2
    # Half a micro-image over the square root of the packets: the error of a centre, of which 4 and more are allowed.
    noise = 0.5 * MICRO_IMAGE / np.sqrt(micro_images(rays)[0][lit].min()) if window else 0.0
    np.testing.assert_allclose(centre[:, lit], true_centre[:, lit], rtol=0.0, atol=0.05 + 4.0 * noise)
    # The rays of the bundle are independent and nearly alike, so that their number gives the error of their power.
    error = true_power[lit] / np.sqrt(micro_images(rays)[0][lit])
    error = np.hypot(error, np.sqrt(micro_images(image.stderr[..., 0] ** 2)[0][lit]))
    z = (power[lit] - true_power[lit]) / error
    assert 2.0 * stats.norm.sf(np.abs(z).max()) > LEVEL / (len(z) * COMPARED)
    total = (image.mean.sum() - truth.sum()) / (truth.sum() / np.sqrt(rays.sum()))
    assert 2.0 * stats.norm.sf(abs(total)) > LEVEL / COMPARED


RANDOM_PLACES, MANY_PLACES = 4, 12


@pytest.mark.parametrize("places", instances([RANDOM_PLACES, MANY_PLACES], long=[MANY_PLACES]))
def test_centres_of_light_are_right_at_random_places(tmp_path, places):
    """In the whole field and refocus range: to 0.05 pixels in every micro-image with a thousandth of the light."""
    random = np.random.default_rng(18)
    compared = 0
    for _ in range(places):
        # From near to far as the camera refocuses, so that light falls on two lenslets or on dozens.
        z = -1.0 / random.uniform(1.0 / 2000.0, 1.0 / 250.0)
        # The field is 17.8 mm wide at 500 mm, and some light falls beside the sensor at its border.
        place = (*random.uniform(8.9 * z / 500.0, -8.9 * z / 500.0, 2), z)
        scene = scene_of([(place, 2.5)], tmp_path).changed({"particles[0].samples": 1 << 19})
        image = lf.render(scene)
        truth, _ = even_bundle(scene, place, 2.5)
        power, centre = micro_images(image.mean[..., 0])
        true_power, true_centre = micro_images(truth)
        lit = true_power > 1e-3 * true_power.sum()
        assert lit.any()
        compared += lit.sum()
        np.testing.assert_allclose(centre[:, lit], true_centre[:, lit], rtol=0.0, atol=0.05, err_msg=str(place))
        assert power.sum() == pytest.approx(true_power.sum(), rel=1e-3)
    assert compared > 8 * places


def test_both_methods_trace_particles_alike_and_close_their_book(tmp_path):
    points = [(place, weight) for place, weight in zip(PLACES, (1.0, 2.0, 0.5), strict=True)]
    scene = scene_of(points, tmp_path).changed({"particles[0].samples": 64})
    adjoint, forward = (lf.render(scene.changed({"transport.method": name})) for name in ("adjoint", "forward"))
    # Nothing else shines, so that both are the very same packets.
    np.testing.assert_array_equal(adjoint.mean, forward.mean)
    np.testing.assert_array_equal(adjoint.stderr, forward.stderr)
    book = adjoint.ledger.lamps
    assert book.emitted == pytest.approx(4.0 * np.pi * 3.5, rel=1e-12)
    assert book.sensor == pytest.approx(adjoint.mean.sum(), rel=1e-12)
    assert abs(book.imbalance) < 1e-13
    assert "particles forward" in adjoint.engine


def test_replicates_tell_the_error(tmp_path):
    """The spread of the total over seeds is the standard error that a render states: chi-squared, both sides."""
    points = [(place, 1.0) for place in PLACES]
    scene = scene_of(points, tmp_path).changed({"particles[0].samples": 64, "transport.method": "forward"})
    images = list(by_seed(scene, range(40)))
    cells = np.array([micro_images(image.mean[..., 0])[0].ravel() for image in images])
    lit = np.flatnonzero(cells.mean(axis=0) > 0.05 * cells.mean(axis=0).sum())
    stated = np.array([micro_images(image.stderr[..., 0] ** 2)[0].ravel() for image in images])[:, lit].mean(axis=0)
    # Sobol' points anticorrelate the pixels of a micro-image, so that its own error is not above the sum of theirs.
    chi2 = (len(images) - 1) * cells[:, lit].var(axis=0, ddof=1) / stated
    assert stats.chi2.sf(chi2, len(images) - 1).min() > LEVEL / len(lit)
    pixel = np.array([image.mean[..., 0].ravel() for image in images])
    error = np.array([image.stderr[..., 0].ravel() for image in images])
    bright = np.argsort(pixel.mean(axis=0))[-20:]
    ratio = pixel[:, bright].var(axis=0, ddof=1) / (error[:, bright] ** 2).mean(axis=0)
    # 40 seeds against 40 x 7 degrees of freedom of the stated errors.
    tail = stats.f.sf(ratio, len(images) - 1, 7 * len(images))
    assert min(tail.min(), (1.0 - tail).min()) > 0.5 * LEVEL / len(bright)


def test_a_target_in_front_hides_particles_and_absorbs_their_light(tmp_path):
    open_scene = scene_of([(PLACES[1], 1.0)], tmp_path).changed({"particles[0].samples": 64})
    screen = {"shape": {"kind": "plane", "width_mm": 100.0, "height_mm": 100.0}, "position_mm": (0.0, 0.0, -480.0)}
    hidden = lf.render(open_scene.changed({"targets": (screen,)}))
    assert hidden.mean.sum() == 0.0
    assert hidden.ledger.lamps.absorbed["targets[0]"] > 0.0
    assert abs(hidden.ledger.lamps.imbalance) < 1e-13
    behind = screen | {"position_mm": (0.0, 0.0, -540.0)}
    free = lf.render(open_scene.changed({"targets": (behind,)}))
    assert free.mean.sum() > 0.0


def test_a_scene_without_particles_has_no_part_of_them():
    world = lf.build(lf.loads(bench_camera(4, 4)))
    assert world.particles == ()
    assert all(part.particles is None for part in parts_of(world))
