"""Rays through random lenses with gradient-index glass against a trace by SciPy that shares nothing with lfmesh.

Curved and aspheric faces, tilted elements, gradients cemented to glass and to each other, light in both directions.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from tests.instances import instances
from tests.validation.gradient_truth import Face, Ray, faces_of, follow

Array = NDArray[np.float64]
Keys = dict[str, Any]

LENSES = 40
IN_SUITE = (0, 1, 2, 3, 4, 5, 6, 7)
RAYS = 24

POSITION_MM = 2e-9
"""Of points on faces. Probe rays fix the number of steps for 1e-9 mm."""
DIRECTION = 2e-9
WEIGHT = 1e-9
RIM_MM = 1e-6
"""Rays that pass a rim or an edge nearer than this may end on either side."""

SEMI, SENSOR_MM, SENSOR_SIDE_MM = 3.0, 10.0, 80.0
KINDS = ("radial_n2", "radial_n", "axial", "spherical")


def random_gradient(draw: np.random.Generator, kind: str) -> Keys:
    """Draw a gradient that changes the index by up to a tenth across the glass."""
    first, second = draw.uniform(0.2, 1.0) * draw.choice([-1.0, 1.0]), draw.uniform(-1.0, 1.0)
    keys: Keys = {"kind": kind, "index": float(draw.uniform(1.5, 1.8))}
    if kind in ("radial_n2", "radial_n"):
        terms = [first * 0.08 / SEMI**2, second * 0.01 / SEMI**4]
    elif kind == "axial":
        terms = [first * 0.02, second * 0.002]
    else:
        keys["radius_mm"] = float(draw.choice([-1.0, 1.0]) * draw.uniform(8.0, 30.0))
        terms = [first * 0.02, second * 0.002]
    return keys | {"coefficients": [float(each) for each in terms]}


def random_face(draw: np.random.Generator) -> Keys:
    face: Keys = {"semi_diameter_mm": SEMI}
    kind = str(draw.choice(["plane", "sphere", "sphere", "conic", "asphere"]))
    if kind != "plane":
        face["radius_mm"] = float(draw.choice([-1.0, 1.0]) * draw.uniform(9.0, 50.0))
    if kind == "conic":
        face["conic"] = float(draw.uniform(-2.0, 0.8))
    if kind == "asphere":
        face["asphere_mm"] = [float(draw.uniform(-2e-4, 2e-4)), float(draw.uniform(-5e-6, 5e-6))]
    return face


def random_lens(draw: np.random.Generator, kind: str) -> tuple[list[Keys], list[Keys]]:
    """Draw one to three elements of one or two glasses each; the first glass of the first one has the gradient."""
    surfaces: list[Keys] = []
    elements: list[Keys] = []
    for number in range(int(draw.integers(1, 4))):
        glasses = int(draw.integers(1, 3))
        first = len(surfaces)
        for glass in range(glasses + 1):
            face = random_face(draw) | {"thickness_mm": float(draw.uniform(2.5, 4.5))}
            if glass < glasses:
                if number == glass == 0:
                    face["gradient"] = random_gradient(draw, kind)
                elif draw.random() < 0.4:
                    face["gradient"] = random_gradient(draw, str(draw.choice(KINDS)))
                else:
                    face["index"] = float(draw.uniform(1.45, 1.85))
            surfaces.append(face)
        if draw.random() < 0.6:
            tilt = [*draw.uniform(-5.0, 5.0, 2), draw.uniform(-180.0, 180.0)]
            shift = draw.uniform(-0.3, 0.3, 3)
            pose = {"tilt_deg": [float(a) for a in tilt], "shift_mm": [float(a) for a in shift]}
            elements.append({"surfaces": list(range(first, len(surfaces))), "pose": pose})
    del surfaces[-1]["thickness_mm"]
    surfaces[0]["stop"] = True
    return surfaces, elements


def scene_of(surfaces: list[Keys], elements: list[Keys]) -> lf.Scene:
    side = {"pixels": [400, 400], "pixel_mm": SENSOR_SIDE_MM / 400}
    return lf.Scene(
        camera={
            "lens": {"surfaces": surfaces, "elements": elements},
            "sensor": {**side, "distance_mm": SENSOR_MM},
        }
    )


def rays_to(face: Face, draw: np.random.Generator, sense: float) -> tuple[Array, Array]:
    """Return rays from 2 mm in front of points of a face, which is the first that they meet, at slopes up to 0.1."""
    turn, r = draw.uniform(0.0, 2.0 * np.pi, RAYS), 0.9 * SEMI * np.sqrt(draw.uniform(size=RAYS))
    x, y = r * np.cos(turn), r * np.sin(turn)
    own = np.column_stack([x, y, [face.sag(float(each)) for each in x * x + y * y]])
    d = np.column_stack([draw.uniform(-0.1, 0.1, (RAYS, 2)), np.ones(RAYS)]) * sense
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return face.vertex + own @ face.axes - 2.0 * d, d


def on_faces(paths: lf.Paths, packet: int, faces: int, sense: float) -> Array:
    """Return the recorded points of a packet on the faces of the lens."""
    names = [f"lens surface {k}" for k in range(faces)]
    at = {vertex.surface: vertex.position for vertex in paths.vertices(packet)}
    return np.array([at[name] for name in (names if sense > 0 else names[::-1])])


def agree(paths: lf.Paths, truth: list[Ray], sense: float, faces: int) -> None:
    """Compare the packets of a trace with rays: what passes, points on all faces, directions, weights."""
    clear = np.array([ray.margin > RIM_MM for ray in truth])
    assert (~clear).sum() <= 2
    passes = np.array([ray.passes for ray in truth])
    if sense > 0:
        arrived = np.isin(paths.body, ["sensor", "beside the sensor"])
    else:
        arrived = (paths.status == lf.Status.ESCAPED) & (paths.weight < 1.0)
    got = np.zeros(len(truth), bool)
    got[paths.source[arrived]] = True
    np.testing.assert_array_equal(got[clear], passes[clear])
    for packet in np.flatnonzero(arrived):
        ray = truth[paths.source[packet]]
        if clear[paths.source[packet]]:
            points = on_faces(paths, int(packet), faces, sense)
            np.testing.assert_allclose(points, ray.points, rtol=0.0, atol=POSITION_MM)
            np.testing.assert_allclose(paths.direction[packet], ray.direction, rtol=0.0, atol=DIRECTION)
            assert abs(paths.weight[packet] - ray.weight) < WEIGHT


@pytest.mark.parametrize("number", instances(range(LENSES), long=[n for n in range(LENSES) if n not in IN_SUITE]))
def test_rays_through_a_random_lens_in_both_directions(number: int) -> None:
    draw = np.random.default_rng([9, number])
    surfaces, elements = random_lens(draw, KINDS[number % len(KINDS)])
    world, faces = lf.build(scene_of(surfaces, elements)), faces_of(surfaces, elements)
    passed = 0
    for sense in (1.0, -1.0):
        origins, directions = rays_to(faces[0] if sense > 0 else faces[-1], draw, sense)
        truth = [follow(faces, *ray, sense) for ray in zip(origins, directions, strict=True)]
        paths = lf.trace(world, origins, directions, split="transmit", record=True)
        agree(paths, truth, sense, len(faces))
        passed += sum(ray.passes for ray in truth)
    assert passed >= 0.5 * RAYS


ELEMENT: list[Keys] = [
    {
        "radius_mm": 14.0, "thickness_mm": 4.0, "semi_diameter_mm": SEMI, "stop": True,
        "gradient": {"kind": "radial_n2", "index": 1.65, "coefficients": [-0.01, 2e-5]},
    },
    {"radius_mm": -22.0, "conic": -0.7, "semi_diameter_mm": SEMI},
]  # fmt: skip


def test_an_element_that_is_posed_is_a_camera_that_is_posed() -> None:
    """The medium turns with the faces of its element."""
    tilt, shift = [4.0, -3.0, 30.0], [0.2, -0.1, 0.3]
    elements = [{"surfaces": [0, 1], "pose": {"tilt_deg": tilt, "shift_mm": shift}}]
    draw = np.random.default_rng(3)
    origins = np.column_stack([draw.uniform(-1.5, 1.5, (200, 2)), np.full(200, -6.0)])
    d = np.column_stack([draw.uniform(-0.15, 0.15, (200, 2)), np.ones(200)])
    one = lf.trace(lf.build(scene_of(ELEMENT, elements)), origins, d, split="transmit", record=True)
    posed = scene_of(ELEMENT, []).changed({"camera.pose": {"tilt_deg": tilt, "shift_mm": shift}})
    other = lf.trace(lf.build(posed), origins, d, split="transmit", record=True)
    compared = 0
    rows = {int(source): packet for packet, source in enumerate(other.source)}
    for packet in np.flatnonzero(one.status == lf.Status.SENSOR):
        match = rows[int(one.source[packet])]
        if other.status[match] == lf.Status.SENSOR:
            points = (on_faces(paths, int(row), 2, 1.0) for paths, row in ((one, packet), (other, match)))
            np.testing.assert_allclose(next(points), next(points), rtol=0.0, atol=1e-12)
            np.testing.assert_allclose(one.direction[packet], other.direction[match], rtol=0.0, atol=1e-12)
            compared += 1
    assert compared > 100


def test_light_that_is_sent_back_returns_along_its_path() -> None:
    """To 1e-11 mm: rays in both directions take the same steps through the glass."""
    world = lf.build(scene_of(ELEMENT, []))
    draw = np.random.default_rng(4)
    origins = np.column_stack([draw.uniform(-2.0, 2.0, (100, 2)), np.full(100, -3.0)])
    d = np.column_stack([draw.uniform(-0.2, 0.2, (100, 2)), np.ones(100)])
    there = lf.trace(world, origins, d, split="transmit", record=True)
    came = np.flatnonzero(there.status == lf.Status.SENSOR)
    assert len(came) > 50
    # From halfway between the lens and the sensor.
    ends = np.array([on_faces(there, int(packet), 2, 1.0)[-1] for packet in came]) + 2.0 * there.direction[came]
    back = lf.trace(world, ends, -there.direction[came], split="transmit", record=True)
    escaped = np.flatnonzero((back.status == lf.Status.ESCAPED) & (back.weight < 1.0))
    assert len(escaped) == len(came)
    for packet in escaped:
        first = int(came[back.source[packet]])
        points = on_faces(there, first, 2, 1.0)[::-1], on_faces(back, int(packet), 2, -1.0)
        np.testing.assert_allclose(points[1], points[0], rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(back.weight[packet], there.weight[first], rtol=1e-11)


def test_both_engines_trace_the_same_rays() -> None:
    """Packets that meet the faces in their order, and blocks of rays."""
    surfaces, elements = random_lens(np.random.default_rng([9, 2]), "spherical")
    world, faces = lf.build(scene_of(surfaces, elements)), faces_of(surfaces, elements)
    origins, directions = rays_to(faces[0], np.random.default_rng(6), 1.0)
    packets = lf.trace(world, origins, directions, split="transmit")
    blocks = lf.trace(world, origins, directions, split="transmit", engine="sequential")
    there = [np.isin(paths.body, ["sensor", "beside the sensor"]) for paths in (packets, blocks)]
    assert there[0].sum() > 5
    np.testing.assert_array_equal(packets.source[there[0]], blocks.source[there[1]])
    np.testing.assert_allclose(packets.position[there[0]], blocks.position[there[1]], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(packets.direction[there[0]], blocks.direction[there[1]], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(packets.weight[there[0]], blocks.weight[there[1]], rtol=1e-12)
