"""Each kind of surface that a STEP file may tell is recognised in any turn, by points that formulas put on it."""

import time
import warnings

import numpy as np
import pytest

from lfmesh.geometry.surfaces.optical_face import Told, told_form

RIM = 7.0
TURNED_BY = 25.0


def disk(seed=0, count=400):
    draw = np.random.default_rng(seed)
    r, phi = RIM * np.sqrt(draw.uniform(size=count)), draw.uniform(0.0, 2.0 * np.pi, count)
    return r * np.cos(phi), r * np.sin(phi)


def frame_turned(degrees, shift=(0.0, 0.0, 0.0)):
    """A body's frame (3, 4), turned about z and shifted."""
    turn = np.deg2rad(degrees)
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin, 0.0, shift[0]], [sin, cos, 0.0, shift[1]], [0.0, 0.0, 1.0, shift[2]]])


def form_of(surface, x, y, z, degrees=TURNED_BY):
    """What is recognised of points of a body that is turned about z and 3 mm along it."""
    place = frame_turned(degrees, (0.0, 0.0, 3.0))
    points = np.column_stack([x, y, z]) @ place[:, :3].T + place[:, 3]
    form, why = told_form(points, [Told(surface, place)])
    assert form is not None, why
    assert form.vertex_z == pytest.approx(3.0, abs=1e-9)
    assert form.distances(points).max() < 1e-9
    return form


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("inner", [False, True])
def test_a_torus_across_the_axis_is_a_toroid_on_its_outside_and_its_inside(inner, sense):
    """Tube of 20 mm whose middle runs on a circle of 50 mm about a line along y."""
    x, y = disk()
    tube = np.sqrt(20.0**2 - y**2)
    if inner:
        # The near side of the hole: 30 mm from the line, hollow towards it across y.
        z = 30.0 - np.sqrt((50.0 - tube) ** 2 - x**2)
        at, radii = 30.0, (-20.0, 30.0)
    else:
        z = 70.0 - np.sqrt((50.0 + tube) ** 2 - x**2)
        at, radii = 70.0, (20.0, 70.0)
    surface = {"kind": "torus", "at": [0.0, 0.0, sense * at], "axis": [0.0, 1.0, 0.0], "radius": 50.0, "tube": 20.0}
    form = form_of(surface, x, y, sense * z)
    assert form.keys["radius_mm"] == pytest.approx(sense * radii[0], rel=1e-12)
    assert form.keys["toroid"].radius_x_mm == pytest.approx(sense * radii[1], rel=1e-12)
    assert form.azimuth_deg == pytest.approx(TURNED_BY, rel=1e-12)


@pytest.mark.parametrize("degrees", [0.0, 25.0, 44.0, 46.0, 90.0, -30.0, -75.0])
def test_a_cylinder_is_turned_by_45_degrees_at_most(degrees):
    x, y = disk()
    z = 30.0 - np.sqrt(30.0**2 - x**2)
    surface = {"kind": "cylinder", "at": [0.0, -9.0, 30.0], "axis": [0.0, 1.0, 0.0], "radius": 30.0}
    form = form_of(surface, x, y, z, degrees)
    assert abs(form.azimuth_deg) <= 45.0
    assert (form.azimuth_deg - degrees) % 90.0 == pytest.approx(0.0, abs=1e-9) or (
        (form.azimuth_deg - degrees) % 90.0 == pytest.approx(90.0, abs=1e-9)
    )


def parabola_spline(radius, along):
    """The parabola u²/2R from u = -9 to 9 as a B-spline of degree 2, u along a direction: exact."""
    points = [(-9.0, 81.0 / (2.0 * radius)), (0.0, -81.0 / (2.0 * radius)), (9.0, 81.0 / (2.0 * radius))]
    return {
        "kind": "spline", "points": [[u * along[0], u * along[1], h] for u, h in points], "weights": [1.0] * 3,
        "degree": 2, "knots": [0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
    }  # fmt: skip


def test_a_parabola_is_an_acylinder_a_paraboloid_and_an_aspheric_toroid():
    x, y = disk()
    shifted = {"kind": "extrusion", "axis": [1.0, 0.0, 0.0], "curve": parabola_spline(25.0, (0.0, 1.0))}
    form = form_of(shifted, x, y, y**2 / 50.0)
    assert form.keys["radius_mm"] == pytest.approx(25.0, rel=1e-12)
    assert form.keys["conic"] == pytest.approx(-1.0, rel=1e-9)
    assert np.isinf(form.keys["toroid"].radius_x_mm)
    assert form.azimuth_deg == pytest.approx(TURNED_BY, rel=1e-9)

    turned = {
        "kind": "revolution",
        "at": [0.0, 0.0, 0.0],
        "axis": [0.0, 0.0, -1.0],
        "curve": parabola_spline(25.0, (1.0, 0.0)),
    }
    form = form_of(turned, x, y, (x**2 + y**2) / 50.0)
    assert form.keys["radius_mm"] == pytest.approx(25.0, rel=1e-12)
    assert form.keys["conic"] == pytest.approx(-1.0, rel=1e-9)
    assert "toroid" not in form.keys

    across = turned | {"at": [0.0, 5.0, 40.0], "axis": [0.0, 1.0, 0.0], "curve": parabola_spline(25.0, (0.0, 1.0))}
    form = form_of(across, x, y, 40.0 - np.sqrt((40.0 - y**2 / 50.0) ** 2 - x**2))
    assert form.keys["radius_mm"] == pytest.approx(25.0, rel=1e-12)
    assert form.keys["toroid"].radius_x_mm == pytest.approx(40.0, rel=1e-12)


def test_a_net_that_is_a_sphere_is_one():
    """A half turn of a quarter circle, both as rational arcs of degree 2."""
    w = float(np.sqrt(0.5))
    arc = [((0.0, -30.0), 1.0), ((30.0, -30.0), w), ((30.0, 0.0), 1.0)]
    turn = [((1.0, 0.0), 1.0), ((1.0, 1.0), w), ((0.0, 1.0), 1.0), ((-1.0, 1.0), w), ((-1.0, 0.0), 1.0)]
    net = {
        "kind": "net", "points": [[[r * c, r * s, 30.0 + h] for (c, s), _ in turn] for (r, h), _ in arc],
        "weights": [[a * b for _, b in turn] for _, a in arc], "degrees": [2, 2],
        "knots": [[0.0, 0.0, 0.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 2.0]],
    }  # fmt: skip
    x, y = disk()
    form = form_of(net, x, y, 30.0 - np.sqrt(900.0 - x**2 - y**2))
    assert form.keys == {"radius_mm": pytest.approx(30.0, rel=1e-11)}


@pytest.mark.parametrize(
    "surface",
    [
        {"kind": "cylinder", "at": [1e-5, 0.0, 30.0], "axis": [0.0, 1.0, 0.0], "radius": 30.0},
        {"kind": "cylinder", "at": [0.0, 0.0, 30.0], "axis": [0.0, 1.0, 1e-5], "radius": 30.0},
        {"kind": "cylinder", "at": [0.0, 0.0, 30.0], "axis": [1e-4, 1.0, 0.0], "radius": 30.0},
        {"kind": "cylinder", "at": [0.0, 0.0, 30.001], "axis": [0.0, 1.0, 0.0], "radius": 30.001},
        {"kind": "cylinder", "at": [0.0, 0.0, 30.0], "axis": [0.0, 0.0, 1.0], "radius": 30.0},
        {"kind": "torus", "at": [0.0, 0.0, 30.0], "axis": [0.0, 1.0, 0.0], "radius": 30.0, "tube": 1e-9},
    ],
)
def test_a_cylinder_that_is_not_quite_the_face_is_not_taken(surface):
    x, y = disk()
    points = np.column_stack([x, y, 30.0 - np.sqrt(900.0 - x**2)])
    surface = surface | {"axis": (np.array(surface["axis"]) / np.linalg.norm(surface["axis"])).tolist()}
    assert told_form(points, [Told(surface, frame_turned(0.0))])[0] is None


def test_absurd_curves_are_no_surface_and_end_soon():
    """However many a file has, and whatever overflows on the way (warnings are errors here)."""
    draw = np.random.default_rng(5)
    x, y = disk()
    points = np.column_stack([x, y, (x**2 + y**2) / 60.0])
    told = []
    for _ in range(200):
        at, values = draw.choice([0.0, 1e-9, 30.0, -1e9, 1e5], (5, 3)), draw.choice([1e-9, 1.0, 1e9], 5)
        curve = {
            "kind": "spline", "degree": 2, "knots": [0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 3.0, 3.0],
            "points": at.tolist(), "weights": values.tolist(),
        }  # fmt: skip
        surface = {"kind": str(draw.choice(["revolution", "extrusion"])), "at": [0.0, 0.0, 0.0], "curve": curve}
        told.append(Told(surface | {"axis": [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]][draw.integers(2)]}, frame_turned(0.0)))
    begun = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert told_form(points, told)[0] is None
    assert time.process_time() - begun < 30.0
