"""Cases made to break the tracer, and the truth they are held against, itself against 30 digits."""

from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest

from lfmesh.accuracy.hard import (
    aim,
    bright_sensors,
    covers,
    diffraction,
    media,
    meshes,
    motions,
    openings,
    pictures,
    tanks,
    truth,
    waves,
)
from lfmesh.accuracy.hard.outcome import Outcome
from lfmesh.accuracy.hard_cases import ALLOWED_LOSS, CASES, line, lost_share
from tests.instances import instances

LONG = [
    aim.skinny_fan,  # vertices_and_edges, needles
    meshes.million_triangles,  # vertices_and_edges
    covers.tilted_behind_a_cover,  # cover_of_index_4; tilted covers in test_sensor_and_cover_ghosts
    bright_sensors.sensor_that_detects_a_thousandth,  # array_before_a_bright_sensor
    tanks.glass_from_clear_to_black,  # total_reflection_in_absorbing_glass
    media.depths_of_absorption,  # depths_of_scattering
    pictures.wall_behind_a_block,  # blocks before walls in transport/render/test_glass_aim
    pictures.sums_of_a_red_band,  # test_bands
    waves.lens_of_fresnel_number_one,  # focal shift in waves/test_point_spread
    diffraction.lenslets_10_um_and_pixels_1_um,  # the same closed form in transport/test_diffraction
    openings.hemispheres_to_the_lens,  # hemispheres_to_the_sensor
    pictures.room_of_one_temperature,  # test_kirchhoff
    motions.a_hundred_motions_at_once,  # spins in test_motion_invariance
    pictures.caustic_of_a_ball,  # bounds of caustics in test_certainty
]
"""Cases of several seconds, each with the quicker ones that show a fault of its kind."""


@pytest.mark.parametrize("case", instances(CASES, long=LONG), ids=[case.__name__ for case in CASES])
def test_right_answer_or_counted_loss(case):
    """What no case loses, the whole suite does not lose: the suite's share is asked of each of them."""
    outcome = case()
    assert outcome.passed, line(outcome)
    assert outcome.lost_energy <= ALLOWED_LOSS * outcome.emitted, line(outcome)


def test_the_suites_lost_share_is_that_of_all_its_energy():
    outcome = Outcome("", "", "", True, 0.0, 3e6, 0)
    assert lost_share([]) == 0.0
    assert lost_share([outcome, replace(outcome, lost_energy=1.0, emitted=1e6)]) == 2.5e-7


def test_every_case_says_in_one_line_what_it_is():
    assert len({case.__doc__ for case in CASES}) == len(CASES)
    assert all(case.__doc__ and "\n" not in case.__doc__ for case in CASES)


FACES = {
    "sphere": truth.Interface(30.0, 2.0, 1.6),
    "hyperboloid": truth.Interface(-25.0, 1.0, 1.5, conic=-2.5),
    "oblate": truth.Interface(40.0, 0.0, 1.7, conic=1.5),
    "plane": truth.Interface(np.inf, 3.0, 1.5),
    "asphere": truth.Interface(45.0, 1.0, 1.5, conic=-1.2, asphere=(3e-6, -2e-9), reach=12.0),
}


def test_the_truth_takes_no_surface_for_another():
    with pytest.raises(NotImplementedError, match="ripple"):
        replace(FACES["sphere"], across=("ripple", 0.1, 0.0)).height(np.zeros(1), np.zeros(1))


@pytest.mark.parametrize("name", FACES)
def test_truth_refracts_as_30_digits_do(name):
    face = FACES[name]
    draw = np.random.default_rng(3)
    for _ in range(20):
        p = np.array([*draw.uniform(-6.0, 6.0, 2), -8.0])
        d = np.array([*draw.uniform(-0.2, 0.2, 2), 1.0])
        d /= np.linalg.norm(d)
        bundle = truth.through([face], [p], [d])
        with mp.workdps(30):
            x, y, z = map(mp.mpf, p)
            u, v, w = map(mp.mpf, d)
            # NumPy's unit vector is not one of length 1 to 30 digits; the truth normalises it as well.
            length = mp.sqrt(u * u + v * v + w * w)
            u, v, w = u / length, v / length, w / length
            c, k = mp.mpf(face.curvature), mp.mpf(face.conic)

            def sag(r2, c=c, k=k, face=face):
                z = c * r2 / (1 + mp.sqrt(1 - (1 + k) * c * c * r2))
                return z + sum(mp.mpf(a) * r2 ** (j + 2) for j, a in enumerate(face.asphere))

            def height(t, x=x, y=y, z=z, u=u, v=v, w=w, sag=sag, face=face):
                return z + t * w - face.z - sag((x + t * u) ** 2 + (y + t * v) ** 2)

            t = mp.findroot(height, (face.z - z) / w)
            px, py = x + t * u, y + t * v
            g = mp.diff(sag, px * px + py * py)
            n = mp.matrix([-2 * g * px, -2 * g * py, 1])
            n /= mp.norm(n)
            incident = mp.matrix([u, v, w])
            cos_i = (n.T * incident)[0]
            eta = 1 / mp.mpf(face.index)
            cos_t = mp.sqrt(1 - eta**2 * (1 - cos_i**2))
            bent = eta * incident + (cos_t - eta * cos_i) * n
            r_s = (cos_i - cos_t / eta) / (cos_i + cos_t / eta)
            r_p = (cos_t - cos_i / eta) / (cos_t + cos_i / eta)
            assert max(abs(float(a) - b) for a, b in zip((px, py, z + t * w), bundle.p[0], strict=True)) < 2e-14
            assert max(abs(float(a) - b) for a, b in zip(bent, bundle.d[0], strict=True)) < 1e-15
            assert abs(float(1 - (r_s**2 + r_p**2) / 2) - bundle.weight[0]) < 1e-15


@pytest.mark.parametrize("hexagonal", [False, True])
def test_truth_takes_the_lenslet_whose_centre_is_nearest(hexagonal):
    plate = truth.Plate(hexagonal, 0.1, 21, 20, 0.3, 0.2, 1.5, 0.2)
    draw = np.random.default_rng(5)
    at = draw.uniform(-0.8, 0.8, (500, 2))
    d = np.tile([0.0, 0.0, 1.0], (500, 1))
    landing, _ = plate.land(np.column_stack([at, np.full(500, -1.0)]), d)
    row, column = np.indices((20, 21))
    centres = plate.centres(column, row).reshape(-1, 2)
    nearest = centres[np.argmin(np.linalg.norm(at[:, None] - centres, axis=2), axis=1)]
    # A ray parallel to the axis is bent towards the axis of its own lenslet, in the plane of both.
    off, bent = at - nearest, landing[0][:, :2] - at
    assert (np.einsum("ij,ij->i", off, bent) < 0.0).all()
    assert np.abs(off[:, 0] * bent[:, 1] - off[:, 1] * bent[:, 0]).max() < 1e-15
