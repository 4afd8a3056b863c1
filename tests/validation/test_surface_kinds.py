"""Aspheres with odd powers: rays through random lenses, against roots by Brent's method and Snell's law."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.view.layout.sections import lens_glass
from tests.instances import instances

Array = NDArray[np.float64]
Sag = Callable[[Any, Any], Any]

SEMI = 4.0
SCAN = 200


def conic(c: float, k: float, r2: Any) -> Any:
    return c * r2 / (1.0 + np.sqrt(1.0 - (1.0 + k) * c * c * r2))


def odd(draw: np.random.Generator, size: float = 1.0) -> tuple[dict[str, Any], Sag]:
    """Return a random surface with odd and even powers, as keys of a scene and as the formula of its sag."""
    radius, k = draw.choice([-1.0, 1.0]) * draw.uniform(9.0, 80.0), draw.uniform(-3.0, 0.8)
    odds = draw.normal(size=3) * 0.12 / SEMI ** np.array([3.0, 5.0, 7.0])
    evens = draw.normal(size=2) * 0.1 / SEMI ** np.array([4.0, 6.0])
    keys = {"radius_mm": radius * size, "conic": k, "odd_asphere_mm": odds / size ** np.array([2.0, 4.0, 6.0])}
    keys["asphere_mm"] = evens / size ** np.array([3.0, 5.0])

    def sag(x: Any, y: Any) -> Any:
        r2 = (x * x + y * y) / size**2
        r = np.sqrt(r2)
        terms = sum(b * r**n for b, n in zip(odds, (3, 5, 7), strict=True))
        return size * (conic(1.0 / radius, k, r2) + terms + evens[0] * r2**2 + evens[1] * r2**3)

    return keys, sag


def curve(draw: np.random.Generator) -> tuple[float, float]:
    """Return a random curvature, now and then 0, and a conic constant."""
    return float(draw.choice([-1.0, 0.0, 1.0], p=[0.4, 0.2, 0.4]) / draw.uniform(8.0, 80.0)), float(
        draw.uniform(-3.0, 0.8)
    )


def radius(c: float, size: float) -> float:
    return size / c if c else np.inf


def biconic(draw: np.random.Generator, size: float = 1.0) -> tuple[dict[str, Any], Sag]:
    """Return a random biconic, by OpticStudio's formula."""
    (cx, kx), (cy, ky) = curve(draw), curve(draw)
    keys = {"radius_mm": radius(cy, size), "conic": ky, "biconic": {"radius_x_mm": radius(cx, size), "conic_x": kx}}

    def sag(x: Any, y: Any) -> Any:
        x2, y2 = (x / size) ** 2, (y / size) ** 2
        root = np.sqrt(1.0 - (1.0 + kx) * cx * cx * x2 - (1.0 + ky) * cy * cy * y2)
        return size * (cx * x2 + cy * y2) / (1.0 + root)

    return keys, sag


def toroid(draw: np.random.Generator, size: float = 1.0) -> tuple[dict[str, Any], Sag]:
    """Return a random toroid: points at the distance |R − f(y)| from the line x = 0, z = R."""
    (cx, _), (cy, ky) = curve(draw), curve(draw)
    evens = draw.normal(size=2) * 0.1 / SEMI ** np.array([4.0, 6.0])
    keys = {"radius_mm": radius(cy, size), "conic": ky, "asphere_mm": evens / size ** np.array([3.0, 5.0])}
    keys["toroid"] = {"radius_x_mm": radius(cx, size)}

    def sag(x: Any, y: Any) -> Any:
        x2, y2 = (x / size) ** 2, (y / size) ** 2
        f = conic(cy, ky, y2) + evens[0] * y2**2 + evens[1] * y2**3
        if cx == 0.0:
            return size * f
        return size * (1.0 / cx - np.sign(cx) * np.sqrt((1.0 / cx - f) ** 2 - x2))

    return keys, sag


def two_zones(draw: np.random.Generator, size: float = 1.0) -> tuple[dict[str, Any], Sag]:
    """Return a random surface whose outer zone has another shape, shifted to join the inner one with a kink."""
    border = float(draw.uniform(0.3, 0.5)) * SEMI
    zones, tables = [], []
    for _ in range(2):
        (c, k), evens = curve(draw), draw.normal(size=2) * 0.1 / SEMI ** np.array([4.0, 6.0])
        zones.append((c, k, evens))
        asphere = evens / size ** np.array([3.0, 5.0])
        tables.append({"radius_mm": radius(c, size), "conic": k, "asphere_mm": asphere})
    keys = tables[0] | {"outer_zone": tables[1] | {"border_mm": border * size}}

    def of_zone(zone: tuple[float, float, Array], r2: Any) -> Any:
        c, k, evens = zone
        return conic(c, k, r2) + evens[0] * r2**2 + evens[1] * r2**3

    step = of_zone(zones[0], border**2) - of_zone(zones[1], border**2)

    def sag(x: Any, y: Any) -> Any:
        r2 = (x * x + y * y) / size**2
        return size * np.where(np.real(r2) > border**2, of_zone(zones[1], r2) + step, of_zone(zones[0], r2))[()]

    return keys, sag


KINDS = {"odd": odd, "biconic": biconic, "toroid": toroid, "two zones": two_zones}


def gradient(sag: Sag, x: float, y: float) -> tuple[float, float]:
    """Return the derivatives of a sag by a complex step, which loses no digits."""
    h = 1e-30
    return float(np.imag(sag(complex(x, h), complex(y)))) / h, float(np.imag(sag(complex(x), complex(y, h)))) / h


def refracted(d: Array, normal: Array, n_i: float, n_t: float) -> Array:
    """Return n_t d' − n_i d parallel to the normal, |d'| = 1."""
    along = n_i * float(d @ normal)
    root = np.sqrt(n_t**2 - n_i**2 + along**2)
    return np.asarray((n_i * d + (np.copysign(root, along) - along) * normal) / n_t)


class Face:
    """A surface of the truth: its vertex, sag, the indices on both sides, and the pose of its element."""

    def __init__(self, z: float, sag: Sag, before: float, after: float, pose: dict[str, Any] | None = None) -> None:
        self.z, self.sag, self.indices = z, sag, (before, after)
        self.turn, self.shift = np.eye(3), np.zeros(3)
        if pose is not None:
            self.turn = Rotation.from_euler("xyz", pose["tilt_deg"], degrees=True).as_matrix()
            self.shift = np.asarray(pose["shift_mm"])

    def through(self, p: Array, d: Array, size: float) -> tuple[Array, Array]:
        """Return point and direction of a ray behind this face; elements turn about the first vertex, the origin."""
        q, e = self.turn.T @ (p - self.shift), self.turn.T @ d

        def above(t: float) -> float:
            at = q + t * e
            return float(at[2] - self.z - self.sag(at[0], at[1]))

        # From 2 mm before the vertex plane to 2 mm behind it, as far as the surface exists.
        ends = np.sort((self.z + np.array([-2.0, 2.0]) * size - q[2]) / e[2])
        steps = np.linspace(max(ends[0], 0.0), ends[1], SCAN)
        with np.errstate(invalid="ignore"):
            height = np.array([above(t) for t in steps])
        k = int(np.argmax(height[:-1] * height[1:] <= 0.0))
        t = brentq(above, steps[k], steps[k + 1], xtol=1e-15 * size, rtol=1e-15)
        at = q + t * e
        by_x, by_y = gradient(self.sag, at[0], at[1])
        normal = np.array([-by_x, -by_y, 1.0]) / np.sqrt(1.0 + by_x**2 + by_y**2)
        n_i, n_t = self.indices if e[2] > 0.0 else self.indices[::-1]
        return self.turn @ at + self.shift, self.turn @ refracted(e, normal, n_i, n_t)


def camera(front: dict[str, Any], back: dict[str, Any], index: float, size: float = 1.0) -> dict[str, Any]:
    """Return a camera with a lens of two surfaces, 5 mm thick, and a sensor 10 mm behind it."""
    first = {"thickness_mm": 5.0 * size, "index": index, "semi_diameter_mm": SEMI * size, "stop": True, **front}
    lens = {"surfaces": [first, {"semi_diameter_mm": SEMI * size, **back}]}
    return {"lens": lens, "sensor": {"pixels": (400, 400), "pixel_mm": 0.1 * size, "distance_mm": 10.0 * size}}


def rays(draw: np.random.Generator, count: int, size: float, *, backwards: bool) -> tuple[Array, Array]:
    """Return rays towards the middle of the lens, from before it or from between it and the sensor."""
    start = np.column_stack([draw.uniform(-2.0, 2.0, (count, 2)), np.full(count, 13.0 if backwards else -9.0)])
    aim = np.column_stack([draw.uniform(-2.2, 2.2, (count, 2)), np.full(count, 5.0 if backwards else 0.0)])
    d = aim - start
    return start * size, d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.mark.parametrize("backwards", [False, True], ids=["to the sensor", "to the objects"])
@pytest.mark.parametrize("seed", instances(range(3), long=[1]))
@pytest.mark.parametrize("kind", KINDS)
def test_rays_are_those_of_the_formula(kind: str, seed: int, backwards: bool) -> None:
    """Of both engines: 1e-9 mm and 1e-9 in direction, on lenses from 0.04 to 400 mm wide, half of them posed."""
    draw = np.random.default_rng([seed, backwards, sorted(KINDS).index(kind)])
    size, index = 10.0 ** (2 * (seed - 1)) if kind != "all" else 1.0, float(draw.uniform(1.3, 1.9))
    (front, front_sag), (back, back_sag) = KINDS[kind](draw, size), KINDS[kind](draw, size)
    pose = None
    given = camera(front, back, index, size)
    if seed % 2:
        pose = {"shift_mm": size * draw.uniform(-0.2, 0.2, 3), "tilt_deg": draw.uniform(-4.0, 4.0, 3)}
        given["lens"]["elements"] = [{"surfaces": [0, 1], "pose": pose}]
    faces = [Face(0.0, front_sag, 1.0, index, pose), Face(5.0 * size, back_sag, index, 1.0, pose)]
    world = lf.build(lf.Scene(camera=given))
    p, d = rays(draw, 40, size, backwards=backwards)
    true_p, true_d = [], []
    for at, to in zip(p, d, strict=True):
        for face in reversed(faces) if backwards else faces:
            at, to = face.through(at, to, size)
        true_p.append(at)
        true_d.append(to)
    for engine in ("mesh", "sequential"):
        paths = lf.trace(world, p, d, split="transmit", record=engine == "mesh", engine=engine)
        ends = lf.Status.ESCAPED if backwards else lf.Status.SENSOR
        arrived = np.flatnonzero(paths.status == ends)
        assert len(arrived) > 25
        for path in arrived:
            source = paths.source[path]
            np.testing.assert_allclose(paths.direction[path], true_d[source], atol=1e-9)
            off = np.cross(paths.position[path] - true_p[source], true_d[source])
            assert np.linalg.norm(off) < 1e-9 * max(size, 1.0)
            if engine == "mesh":
                left = paths.vertices(path)[2].position
                np.testing.assert_allclose(left, true_p[source], atol=1e-9 * max(size, 1.0))


def test_even_powers_up_to_30_are_those_of_the_formula() -> None:
    """Parallel rays out to the rim, where the term in r³⁰ lifts the surface by 0.02 mm."""
    c, conic_constant, highest = 1.0 / 30.0, -0.5, 0.02 / SEMI**30
    front = {"radius_mm": 1.0 / c, "conic": conic_constant, "asphere_mm": [1e-4, *[0.0] * 12, highest]}

    def sag(x: Any, y: Any) -> Any:
        r2 = x * x + y * y
        return conic(c, conic_constant, r2) + 1e-4 * r2**2 + highest * r2**15

    heights = np.linspace(-0.99, 0.99, 41)[:, None] * SEMI * np.array([[0.6, 0.8]])
    p = np.column_stack([heights, np.full(41, -9.0)])
    d = np.tile([0.0, 0.0, 1.0], (41, 1))
    face = Face(0.0, sag, 1.0, 1.5)
    true_p, true_d = zip(*(face.through(at, to, 1.0) for at, to in zip(p, d, strict=True)), strict=True)
    world = lf.build(lf.Scene(camera=camera(front, {"radius_mm": np.inf}, 1.5)))
    paths = lf.trace(world, p, d, split="transmit", record=True, engine="mesh")
    assert len(paths.status) == 41
    for path, source in enumerate(paths.source):
        first, second = (paths.vertices(path)[k].position for k in (1, 2))
        np.testing.assert_allclose(first, true_p[source], atol=1e-10)
        np.testing.assert_allclose(second - first, true_d[source] * np.linalg.norm(second - first), atol=1e-9)
    fast = lf.trace(world, p, d, split="transmit", engine="sequential")
    np.testing.assert_allclose(
        fast.position[np.argsort(fast.source)], paths.position[np.argsort(paths.source)], atol=1e-9
    )


def test_without_odd_powers_an_odd_asphere_is_the_even_one() -> None:
    draw = np.random.default_rng(3)
    even = {"radius_mm": 14.0, "conic": -0.4, "asphere_mm": (2e-4, -3e-6)}
    p, d = rays(draw, 200, 1.0, backwards=False)
    found = []
    # A coefficient this small moves nothing, but makes the kernels take the way of odd powers.
    for odds in ((), (1e-300,)):
        world = lf.build(lf.Scene(camera=camera({**even, "odd_asphere_mm": odds}, {"radius_mm": -30.0}, 1.6)))
        found.append(lf.trace(world, p, d, split="transmit"))
    np.testing.assert_array_equal(found[0].status, found[1].status)
    np.testing.assert_allclose(found[0].position, found[1].position, atol=1e-13)
    np.testing.assert_allclose(found[0].weight, found[1].weight, rtol=1e-13)


def test_zemax_files_have_biconics_and_toroids(tmp_path: Any) -> None:
    """Written and read they are the same lens, flat sections too; terms beyond y¹⁴ are refused."""
    back = {**TORIC, "toroid": {"radius_x_mm": np.inf}}
    lens = lf.Scene(camera=camera({**OPPOSED, "conic": -0.5}, back, 1.5)).camera.lens
    write_lens_file(lens, tmp_path / "lens.zmx")
    read, _ = read_lens_file(tmp_path / "lens.zmx")
    keys = ("radius_mm", "conic", "asphere_mm", "biconic", "toroid", "semi_diameter_mm", "thickness_mm")
    for one, other in zip(lens.surfaces, read.surfaces, strict=True):
        assert [getattr(one, key) for key in keys] == [getattr(other, key) for key in keys]
    many = {**TORIC, "asphere_mm": (0.0,) * 6 + (1e-20,)}
    lens = lf.Scene(camera=camera(many, OPPOSED, 1.5)).camera.lens
    with pytest.raises(SceneError, match="asphere_mm: Zemax's toroid has 6 terms from y⁴"):
        write_lens_file(lens, tmp_path / "lens.zmx")


def refused(message: str, **keys: Any) -> None:
    with pytest.raises(SceneError, match=message):
        lf.Surface(**{"radius_mm": 30.0, "semi_diameter_mm": 5.0, "index": 1.5, **keys})


def test_odd_powers_that_no_surface_can_have_are_refused() -> None:
    refused("odd_asphere_mm", odd_asphere_mm=[0.0] * 15)
    refused(r"odd_asphere_mm\[1\] = 1e\+300: times r\^5", odd_asphere_mm=[0.0, 1e300])
    refused("odd_asphere_mm", odd_asphere_mm=["a"])
    refused("odd_asphere_mm.*omit it", odd_asphere_mm=[1e-4], qbfs={"norm_radius_mm": 5.0, "coefficients_mm": [0.1]})
    refused("odd_asphere_mm.*omit it", odd_asphere_mm=[1e-4], paraxial=True, focal_length_mm=50.0, radius_mm=np.inf)


def test_zemax_files_have_odd_powers(tmp_path: Any) -> None:
    """Written and read they are the same; CODE V's, and powers beyond r⁸, are refused."""
    own = {"odd_asphere_mm": (1e-4, -2e-6), "asphere_mm": (3e-5,), "conic": -0.5, "radius_mm": 20.0}
    lens = lf.Scene(camera=camera(own, {"radius_mm": -40.0}, 1.5)).camera.lens
    write_lens_file(lens, tmp_path / "lens.zmx")
    read, _ = read_lens_file(tmp_path / "lens.zmx")
    front = read.surfaces[0]
    assert (front.odd_asphere_mm, front.asphere_mm, front.conic) == ((1e-4, -2e-6), (3e-5,), -0.5)
    with pytest.raises(SceneError, match="odd_asphere_mm: not written to CODE V"):
        write_lens_file(lens, tmp_path / "lens.seq")
    own["odd_asphere_mm"] = (0.0, 0.0, 0.0, 1e-9)
    lens = lf.Scene(camera=camera(own, {"radius_mm": -40.0}, 1.5)).camera.lens
    with pytest.raises(SceneError, match=r"odd_asphere_mm: Zemax's odd asphere has powers up to r\^8"):
        write_lens_file(lens, tmp_path / "lens.zmx")


SPHERE = {"radius_mm": 17.0}
ELLIPSOID = {"radius_mm": -21.0, "conic": 0.6}
AS_TOROID = {**SPHERE, "toroid": {"radius_x_mm": 17.0}}
AS_BICONIC = {**ELLIPSOID, "biconic": {"radius_x_mm": -21.0, "conic_x": 0.6}}


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
@pytest.mark.parametrize(
    ("front", "same"),
    [(SPHERE, AS_TOROID), (ELLIPSOID, AS_BICONIC), ({"radius_mm": np.inf}, {"toroid": {"radius_x_mm": 1e12}})],
    ids=["toroid of equal radii: sphere", "biconic of equal sections: conic", "toroid of huge radius: plane"],
)
def test_equal_sections_are_a_surface_of_revolution(front: Any, same: Any, engine: str) -> None:
    """Landing within 1e-12 mm, transmittance within 1e-13, first order the same."""
    p, d = rays(np.random.default_rng(5), 200, 1.0, backwards=False)
    found = []
    for shape in (front, same):
        scene = lf.Scene(camera=camera(shape, {"radius_mm": -60.0}, 1.6))
        found.append((lf.trace(lf.build(scene), p, d, split="transmit", engine=engine), lf.first_order(scene)))
    (paths, facts), (others, of_other) = found
    np.testing.assert_array_equal(paths.status, others.status)
    np.testing.assert_allclose(paths.position, others.position, atol=1e-12)
    np.testing.assert_allclose(paths.weight, others.weight, rtol=1e-13)
    assert of_other.efl_mm == pytest.approx(facts.efl_mm, rel=1e-9)
    assert of_other.efl_x_mm == pytest.approx(facts.efl_mm, rel=1e-9)


def test_a_biconic_turned_by_90_degrees_has_its_sections_exchanged() -> None:
    p, d = rays(np.random.default_rng(6), 200, 1.0, backwards=False)
    one = camera({"radius_mm": 30.0, "biconic": {"radius_x_mm": 14.0, "conic_x": -0.7}}, {"radius_mm": -40.0}, 1.5)
    one["lens"]["elements"] = [{"surfaces": [0, 1], "pose": {"tilt_deg": (0.0, 0.0, 90.0)}}]
    other = {"radius_mm": 14.0, "conic": -0.7, "biconic": {"radius_x_mm": 30.0}}
    scenes = [lf.Scene(camera=one), lf.Scene(camera=camera(other, {"radius_mm": -40.0}, 1.5))]
    turned, exchanged = (lf.trace(lf.build(scene), p, d, split="transmit") for scene in scenes)
    np.testing.assert_array_equal(turned.status, exchanged.status)
    landed = turned.status == lf.Status.SENSOR
    assert landed.sum() > 150
    np.testing.assert_allclose(turned.position[landed], exchanged.position[landed], atol=1e-12)


def test_a_cylinder_bends_light_in_its_section_alone() -> None:
    """Thorlabs' LJ1821L1: 25.84 mm, 4.01 mm of N-BK7, stated f = 50 mm; circle and plane plate in closed form.

    In x a ray at height h meets the circle at the angle of sine h/R, and the plane behind it after Snell's law; in y a
    plate shifts a ray that comes at the angle θ by t (tan θ − tan θ').
    """
    radius, thickness = 25.84, 4.01
    index = 1.5168000345005885
    lens = camera({"toroid": {"radius_x_mm": radius}}, {}, index)
    lens["lens"]["surfaces"][0]["thickness_mm"] = thickness
    lens["sensor"]["distance_mm"] = 30.0
    scene = lf.Scene(camera=lens)
    facts = lf.first_order(scene)
    assert facts.efl_x_mm == pytest.approx(radius / (index - 1.0), rel=1e-12)
    assert abs(facts.efl_x_mm - 50.0) < 0.05
    assert np.isinf(facts.efl_mm)
    h, theta = np.linspace(-3.0, 3.0, 13), 0.05
    p = np.column_stack([h, np.full(13, -1.0 - 10.0 * np.tan(theta)), np.full(13, -10.0)])
    d = np.tile([0.0, np.sin(theta), np.cos(theta)], (13, 1))
    flat = np.column_stack([h, np.zeros(13), np.full(13, -10.0)]), np.tile([0.0, 0.0, 1.0], (13, 1))
    for engine in ("mesh", "sequential"):
        paths = lf.trace(lf.build(scene), *flat, split="transmit", engine=engine)
        inside = np.arcsin(h / radius) - np.arcsin(h / radius / index)
        sag = radius - np.sqrt(radius**2 - h**2)
        behind = h - (thickness - sag) * np.tan(inside)
        landed = behind - 30.0 * np.tan(np.arcsin(index * np.sin(inside)))
        np.testing.assert_allclose(paths.position[:, 0], landed, atol=1e-11)
        np.testing.assert_allclose(paths.position[:, 1], 0.0, atol=1e-13)
        # On the middle line, x = 0, the cylinder is a plate to rays inclined in y.
        middle = lf.trace(lf.build(scene), p[6:7], d[6:7], split="transmit", engine=engine)
        in_plate = np.arcsin(np.sin(theta) / index)
        y = -1.0 + thickness * np.tan(in_plate) + 30.0 * np.tan(theta)
        np.testing.assert_allclose(middle.position[0, :2], [0.0, y], atol=1e-11)


def test_a_rod_has_the_focal_length_of_the_textbook() -> None:
    """n R / (2 (n − 1)) for a full cylinder (Hecht, Optics, 5.2), behind its middle, and none in the other section."""
    rod = [{"toroid": {"radius_x_mm": side * 5.0}, "semi_diameter_mm": 2.0} for side in (1.0, -1.0)]
    rod[0] |= {"thickness_mm": 10.0, "index": 1.5, "stop": True}
    scene = lf.Scene(
        camera={"lens": {"surfaces": rod}, "sensor": {"pixels": (80, 80), "pixel_mm": 0.1, "distance_mm": 2.5}}
    )
    facts = lf.first_order(scene)
    assert facts.efl_x_mm == pytest.approx(1.5 * 5.0 / (2.0 * 0.5), rel=1e-12)
    # The focus lies n R / (2 (n − 1)) from the rod's middle: 2.5 mm behind it.
    h = 1e-4
    paths = lf.trace(lf.build(scene), [[h, 0.5, -5.0], [0.0, 0.5, -5.0]], [[0.0, 0.0, 1.0]] * 2, split="transmit")
    np.testing.assert_allclose(paths.position[:, :2], [[0.0, 0.5], [0.0, 0.5]], atol=1e-10)


TORIC = {"radius_mm": 26.0, "asphere_mm": (1e-5,), "toroid": {"radius_x_mm": 15.0}}
OPPOSED = {"radius_mm": 40.0, "biconic": {"radius_x_mm": -33.0, "conic_x": 0.5}}


@pytest.mark.parametrize(("level", "order"), [("flat", 0.9), ("smooth", 1.8), ("patch", 1.9)])
def test_meshes_converge_at_their_order(level: str, order: float) -> None:
    """Landing against that on the exact surfaces: flat 1, smooth 2, patch 2 as on every surface but spheres."""
    p, d = rays(np.random.default_rng(8), 1500, 1.0, backwards=False)
    scene = lf.Scene(camera=camera({**TORIC, "odd_asphere_mm": ()}, OPPOSED, 1.6))
    truth = lf.trace(lf.build(scene), p, d, split="transmit")
    errors = []
    for rings in (8, 16):
        world = lf.build(scene.changed({"transport.surface": level}), rings=rings)
        paths = lf.trace(world, p, d, split="transmit")
        both, of_truth, of_mesh = np.intersect1d(
            truth.source[truth.status == lf.Status.SENSOR],
            paths.source[paths.status == lf.Status.SENSOR],
            return_indices=True,
        )
        assert len(both) > 1400
        off = truth.position[truth.status == lf.Status.SENSOR][of_truth]
        off = off - paths.position[paths.status == lf.Status.SENSOR][of_mesh]
        errors.append(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    assert np.log2(errors[0] / errors[1]) > order
    assert errors[1] < {"flat": 0.2, "smooth": 0.02, "patch": 1e-3}[level]


def test_reflections_lose_no_light() -> None:
    """Of all paths through a toric element behind a saddle, both ways: nothing is lost, and the books close."""
    front = {"thickness_mm": 4.0, "index": 1.6, "semi_diameter_mm": SEMI, "stop": True, **OPPOSED}
    surfaces = [
        front,
        {"thickness_mm": 0.02, "semi_diameter_mm": SEMI, **TORIC},
        {"thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": SEMI, **TORIC},
        {"semi_diameter_mm": SEMI, "radius_mm": -30.0, "odd_asphere_mm": (2e-4,)},
    ]
    sensor = {"pixels": (200, 200), "pixel_mm": 0.1, "distance_mm": 20.0, "reflectance": 0.3}
    world = lf.build(lf.Scene(camera={"lens": {"surfaces": surfaces}, "sensor": sensor}))
    p, d = rays(np.random.default_rng(9), 1000, 1.0, backwards=False)
    paths = lf.trace(world, p, d, split="both")
    assert not (paths.status == lf.Status.LOST).any()
    # What roulette does to the sum of 1000 packets.
    assert paths.weight.sum() == pytest.approx(1000.0, rel=1e-2)
    assert world.mesh("lens[0]").is_watertight
    assert world.mesh("lens[1]").is_watertight


def test_layouts_show_the_section_y_z_and_the_edge_of_the_mesh() -> None:
    """Front of a toroid, 26 mm and 1e-5 y⁴; the edge is a cylinder at the wider rim, to the depth of its chords."""
    narrow = {**TORIC, "semi_diameter_mm": 3.0}
    world = lf.build(lf.Scene(camera=camera(narrow, OPPOSED, 1.6)))
    (glass,) = lens_glass(world.lens_shape, np.array([1.0, 1.6, 1.0]))
    z, y = glass.front.T
    np.testing.assert_allclose(z, conic(1.0 / 26.0, 0.0, y * y) + 1e-5 * y**4, atol=1e-9)
    rim = world.lens_shape.rims[1]
    assert rim * np.cos(np.pi / world.lens_shape.azimuths) - 1e-6 <= glass.outline[:, 1].max() <= rim + 1e-6
    assert 3.0 < glass.front[-1, 1] < 3.2


def test_what_no_section_can_have_is_refused() -> None:
    refused("radius_x_mm.*missing", toroid={})
    refused(r"radius_x_mm = 0", toroid={"radius_x_mm": 0.0})
    refused("toroid: biconic is given too", biconic={"radius_x_mm": 9.0}, toroid={"radius_x_mm": 9.0})
    refused("asphere_mm.*omit it: a biconic has no such terms", biconic={"radius_x_mm": 9.0}, asphere_mm=(1e-5,))
    refused("odd_asphere_mm.*omit it: a toroid", toroid={"radius_x_mm": 9.0}, odd_asphere_mm=(1e-5,))
    own = {"norm_radius_mm": 5.0, "coefficients_mm": (0.1,)}
    refused("qcon: omit it", toroid={"radius_x_mm": 9.0}, qcon=own)
    refused("semi_diameter_mm = 5.0: .*radius_x_mm = 4 .*ends 4 mm", biconic={"radius_x_mm": 4.0})
    refused("semi_diameter_mm = 5.0: .*radius_x_mm = -4 the surface ends", toroid={"radius_x_mm": -4.0})
    refused(
        "toroid: omit it: a paraxial", paraxial=True, focal_length_mm=9.0, radius_mm=np.inf, toroid={"radius_x_mm": 9.0}
    )
    # A saddle that comes through the plane behind it in x alone: its sag there is 0.4041 mm.
    front = {"radius_mm": -20.0, "biconic": {"radius_x_mm": 20.0}, "thickness_mm": 0.3, "index": 1.5}
    with pytest.raises(SceneError, match=r"surfaces 0 and 1 cross inside their clear aperture, by 0\.1041 mm"):
        lf.Scene(camera=camera(front, {}, 1.5))


def test_what_knows_surfaces_of_revolution_alone_says_so(tmp_path: Any) -> None:
    scene = lf.Scene(camera=camera(TORIC, OPPOSED, 1.6))
    with pytest.raises(lf.LfmeshError, match=r"camera.lens.surfaces\[0\].toroid: the lens sheet"):
        lf.analyse(scene)
    with pytest.raises(SceneError, match=r"surfaces\[0\].toroid: not written to CODE V files"):
        write_lens_file(scene.camera.lens, tmp_path / "lens.seq")
    warnings = "\n".join(lf.first_order(scene).warnings)
    assert "anamorphic" in warnings
    assert "astigmatic" in warnings
