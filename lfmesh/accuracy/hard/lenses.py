"""Lenses: surfaces close to each other, extreme curvature, aspheres that mislead Newton's method."""

import numpy as np

from lfmesh.accuracy.hard.outcome import (
    Outcome,
    case,
    cut,
    disk,
    faces_of,
    lens_scene,
    on_sensor,
    outcome,
    sensor_z,
    surfaces_of,
    through_lens,
    tilted,
)
from lfmesh.accuracy.hard.truth import Array, at_plane, through
from lfmesh.scene import Surface
from lfmesh.scene.camera.outer_zone import OuterZone
from lfmesh.scene.camera.phase import PhaseZone, ZonedPhase
from lfmesh.scene.camera.sections import Biconic, Toroid
from lfmesh.transport.build import build
from lfmesh.transport.trace import Status, trace


def _bundle(count: int, radius: float, spread: float = 0.1) -> tuple[Array, Array]:
    d = tilted(count, spread)
    return np.column_stack([disk(radius, count), np.zeros(count)]) - 60.0 * d, d


def _air_gap(gap: float, meniscus: bool = True) -> Outcome:
    inner = -40.0 if meniscus else np.inf
    surfaces = surfaces_of((
        (60.0, 5.0, 1.62), (inner, gap, 1.0), (inner, 3.0, 1.72), (-200.0, 0.0, 1.0),
    ))  # fmt: skip
    o, d = _bundle(20_000, 9.9)
    return through_lens(lens_scene(surfaces), o, d, 1e-11)


@case
def thin_lenses_at_every_angle() -> Outcome:
    """Cross thin lenses of f/0.3 on either side of glass, up to 80 degrees and to their rims."""
    surfaces = [
        Surface(paraxial=True, focal_length_mm=6.0, thickness_mm=2.0, semi_diameter_mm=10.0, stop=True),
        Surface(radius_mm=30.0, thickness_mm=4.0, index=1.7, semi_diameter_mm=10.0),
        Surface(radius_mm=-30.0, thickness_mm=2.0, semi_diameter_mm=10.0),
        Surface(paraxial=True, focal_length_mm=-6.0, semi_diameter_mm=10.0),
    ]
    d = tilted(20_000, 5.6)
    o = np.column_stack([disk(9.99, 20_000), np.zeros(20_000)]) - 5.0 * d
    return through_lens(lens_scene(surfaces, sensor_mm=1e4), o, d, 1e-9)


@case
def flat_port_in_water() -> Outcome:
    """Look through a window into water, at angles up to total reflection."""
    surfaces = surfaces_of(((np.inf, 5.0, 1.5), (np.inf, 0.0, 1.0)))
    scene = lens_scene(surfaces, sensor_mm=1e4).changed({"camera.lens.object_medium": {"index": 1.333}})
    # The tangent of the critical angle is 1.1345: some rays leave at 87 degrees, where rounding grows 300-fold.
    d = tilted(20_000, 1.134)
    o = np.column_stack([disk(3.0, 20_000), np.zeros(20_000)]) - 5.0 * d
    return through_lens(scene, o, d, 1e-8)


@case
def steep_face_into_oil() -> Outcome:
    """Leave dense glass through a steep face into oil, at angles up to and beyond total reflection."""
    first, last = surfaces_of(((40.0, 8.0, 1.9), (-12.0, 0.0, 1.0)))
    oiled = last.model_copy(update={"index": 1.4})
    o, d = _bundle(20_000, 9.9)
    # Near the critical angle the cosine behind the face has lost half of its digits.
    return through_lens(lens_scene([first, oiled], sensor_mm=1e4), o, d, 1e-6, relative=1e-7)


@case
def gap_10_um() -> Outcome:
    """Cross 10 µm of air between curved faces."""
    return _air_gap(0.01)


@case
def gap_1_um() -> Outcome:
    """Cross 1 µm of air between curved faces."""
    return _air_gap(0.001)


@case
def gap_100_nm() -> Outcome:
    """Cross 0.1 µm of air between curved faces, less than their meshes can resolve."""
    return _air_gap(0.0001)


@case
def flat_gap_100_nm() -> Outcome:
    """Cross 0.1 µm of air between flat faces."""
    return _air_gap(0.0001, meniscus=False)


@case
def cemented_triplet() -> Outcome:
    """Cross three cemented glasses with two interfaces that each belong to two elements."""
    surfaces = surfaces_of((
        (40.0, 6.0, 1.5168), (-30.0, 2.0, 1.7283), (28.0, 5.0, 1.6204), (-60.0, 0.0, 1.0),
    ))  # fmt: skip
    o, d = _bundle(20_000, 9.9)
    return through_lens(lens_scene(surfaces), o, d, 1e-11)


@case
def thin_meniscus() -> Outcome:
    """Cross a meniscus of 20 µm, thinner than the sag error of a coarse mesh of its faces."""
    surfaces = surfaces_of(((12.0, 0.02, 1.5), (12.0, 0.0, 1.0)))
    o, d = _bundle(20_000, 9.9)
    return through_lens(lens_scene(surfaces), o, d, 1e-11)


@case
def touching_edges() -> Outcome:
    """Cross two lenses that touch at their rims, so that the air between them ends in an edge."""
    sag = 50.0 - np.sqrt(50.0**2 - 10.0**2)
    surfaces = surfaces_of((
        (80.0, 5.0, 1.5), (50.0, 2.0 * sag, 1.0), (-50.0, 5.0, 1.6), (-90.0, 0.0, 1.0),
    ))  # fmt: skip
    o, d = _bundle(20_000, 9.999)
    return through_lens(lens_scene(surfaces), o, d, 1e-11)


@case
def touching_vertices() -> Outcome:
    """Cross two lenses that touch at a point on the axis, where the air between them vanishes."""
    surfaces = surfaces_of((
        (80.0, 5.0, 1.5), (-50.0, 0.0, 1.0), (50.0, 5.0, 1.6), (-90.0, 0.0, 1.0),
    ))  # fmt: skip
    draw = np.random.default_rng(4)
    o, d = _bundle(20_000, 9.9)
    # Half of them pass the point of contact within 1e-1 to 1e-9 mm.
    near = 10_000
    o[:near] = np.column_stack(
        [draw.normal(size=(near, 2)) * 10.0 ** draw.uniform(-9.0, -1.0, (near, 1)), np.zeros(near)]
    )
    o[:near] -= 60.0 * d[:near] - [0.0, 0.0, 5.0]
    return through_lens(lens_scene(surfaces), o, d, 1e-11)


@case
def whispering_gallery() -> Outcome:
    """Creep along the inside of a ball, at 1e-1 to 1e-4 rad, between surface and mesh."""
    surfaces = surfaces_of(((5.0, 10.0, 1.5), (-5.0, 0.0, 1.0)), 4.5)
    draw = np.random.default_rng(6)
    n = 5000
    grazing, latitude = 10.0 ** draw.uniform(-4.0, -1.0, n), draw.uniform(-0.5, 0.5, n)
    phi = draw.uniform(0.0, 2.0 * np.pi, n)
    # Start 1e-6 mm below the front, in a plane through the centre, where the next point of the polygonal path is
    # known.
    theta = 0.3 + 0.5 * np.abs(latitude)
    out = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)])
    along = np.column_stack([-np.cos(theta) * np.cos(phi), -np.cos(theta) * np.sin(phi), -np.sin(theta)])
    d = np.cos(grazing)[:, None] * along - np.sin(grazing)[:, None] * out
    centre = np.array([0.0, 0.0, 5.0])
    o = centre + (5.0 - 1e-6) * out
    paths = trace(build(lens_scene(surfaces, distance=4.0)), o, d, split="transmit", record=True, max_events=1)
    p = o - centre
    b = np.einsum("ij,ij->i", p, d)
    true = o + (np.sqrt(b * b + 25.0 - np.einsum("ij,ij->i", p, p)) - b)[:, None] * d
    inside = np.hypot(true[:, 0], true[:, 1]) < 4.5
    met = np.array([paths.vertices(i)[1].position for i in range(len(paths))])
    lost = paths.status == Status.LOST
    judged = inside & ~lost & (true[:, 2] < 5.0)
    error = np.linalg.norm(met - true[paths.source], axis=1)[judged].max(initial=0.0)
    return outcome(
        paths, f"{int(judged.sum())} of {n} rays meet the same face next, to 1e-10 mm",
        f"error {error:.1e} mm, {int(lost.sum())} lost", bool(judged.any()) and error < 1e-10,
    )  # fmt: skip


@case
def ball_lens() -> Outcome:
    """Cross a ball lens up to 0.999 of its radius."""
    surfaces = surfaces_of(((5.0, 10.0, 1.5), (-5.0, 0.0, 1.0)), 4.995)
    o, d = _bundle(20_000, 4.99, 0.02)
    return through_lens(lens_scene(surfaces, distance=4.0), o, d, 1e-11)


@case
def hemisphere() -> Outcome:
    """Meet a hemisphere up to 1e-7 mm from the rim, where its slope is infinite."""
    surfaces = [
        Surface(radius_mm=5.0, thickness_mm=5.0, index=1.2, semi_diameter_mm=5.0, stop=True),
        Surface(semi_diameter_mm=5.0),
    ]
    draw = np.random.default_rng(5)
    r = 5.0 - 10.0 ** draw.uniform(-7.0, 0.6, 20_000)
    phi = draw.uniform(0.0, 2.0 * np.pi, len(r))
    o = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.full(len(r), -20.0)])
    # 1e-7 mm from the rim the slope of 7e3 multiplies the rounding of a ray's position.
    return through_lens(
        lens_scene(surfaces, distance=3.0), o, np.tile([0.0, 0.0, 1.0], (len(r), 1)), 1e-8,
        relative=1e-6,
    )  # fmt: skip


@case
def diverging_newton() -> Outcome:
    """Meet a steep bump of the eighth order on a plane, where Newton's method diverges."""
    surfaces = [
        Surface(asphere_mm=(0.0, 0.0, -3e-7), thickness_mm=4.0, index=1.2, semi_diameter_mm=8.0, stop=True),
        Surface(radius_mm=-90.0, semi_diameter_mm=12.0),
    ]
    o, d = _bundle(5000, 7.99, 0.6)
    # Spread over the plane of the rim, which protrudes towards the rays.
    o[:, 2] -= 6.2
    return through_lens(lens_scene(surfaces, distance=10.0), o, d, 1e-10, relative=1e-10)


@case
def mild_asphere_of_a_deep_sphere() -> Outcome:
    """Meet Forbes' mild asphere to its rim, where its sphere is inclined by 36 degrees."""
    qbfs = {"norm_radius_mm": 5.0, "coefficients_mm": (0.3, -0.1, 0.05, -0.02)}
    surfaces = [
        Surface(radius_mm=8.5, thickness_mm=6.0, index=1.6, semi_diameter_mm=5.0, stop=True, qbfs=qbfs),
        Surface(radius_mm=-60.0, semi_diameter_mm=8.0),
    ]
    o, d = _bundle(5000, 4.99, 0.3)
    return through_lens(lens_scene(surfaces, distance=8.0), o, d, 1e-10, relative=1e-10)


@case
def odd_powers() -> Outcome:
    """Meet a ring-shaped ridge of odd powers, r³ and r⁵, at up to 30 degrees and to the rim."""
    surfaces = [
        Surface(
            radius_mm=25.0, odd_asphere_mm=(4e-3, -6e-5), thickness_mm=5.0, index=1.6, semi_diameter_mm=8.0, stop=True
        ),
        Surface(radius_mm=-60.0, odd_asphere_mm=(-1e-4,), semi_diameter_mm=12.0),
    ]
    o, d = _bundle(5000, 7.99, 0.6)
    return through_lens(lens_scene(surfaces, distance=10.0), o, d, 1e-10, relative=1e-10)


@case
def deep_toroid() -> Outcome:
    """Meet a toroid to 0.99 of the radius of its circle in x, and a cylinder behind it."""
    surfaces = [
        Surface(
            radius_mm=8.0, toroid=Toroid(radius_x_mm=5.0), thickness_mm=9.0, index=1.3, semi_diameter_mm=4.95, stop=True
        ),
        Surface(toroid=Toroid(radius_x_mm=-40.0), semi_diameter_mm=9.0),
    ]
    o, d = _bundle(5000, 4.94, 0.05)
    return through_lens(lens_scene(surfaces, distance=5.0, sensor_mm=60.0), o, d, 1e-9, relative=1e-8)


@case
def steep_saddles() -> Outcome:
    """Meet saddles that rise in x and fall in y by up to 30 degrees, with equally steep rays."""
    saddle = Biconic(radius_x_mm=11.0, conic_x=-1.5)
    surfaces = [
        Surface(
            radius_mm=-12.0, conic=0.3, biconic=saddle, thickness_mm=12.0, index=1.4, semi_diameter_mm=6.0, stop=True
        ),
        Surface(radius_mm=70.0, toroid=Toroid(radius_x_mm=-14.0), semi_diameter_mm=10.0),
    ]
    o, d = _bundle(5000, 5.99, 0.6)
    return through_lens(lens_scene(surfaces, distance=12.0, sensor_mm=100.0), o, d, 1e-10, relative=1e-10)


@case
def both_sides_of_a_kink() -> Outcome:
    """Meet a valley and a ridge between zones from 0.1 to 1e-11 mm beside their borders, where a phase changes too."""
    border, count = 3.0, 4000
    phase = ZonedPhase(
        zones=(
            PhaseZone(border_mm=border, coefficients_rad=(-300.0,), radius_mm=border),
            PhaseZone(coefficients_rad=(500.0,), radius_mm=border, offset_rad=40.0),
        )
    )
    surfaces = [
        Surface(
            radius_mm=12.0, outer_zone=OuterZone(border_mm=border, radius_mm=8.0, conic=-0.5, asphere_mm=(1e-4,)),
            phase=phase, thickness_mm=5.0, index=1.5, semi_diameter_mm=5.0, stop=True,
        ),
        Surface(
            radius_mm=-14.0, outer_zone=OuterZone(border_mm=2.0, radius_mm=-60.0), semi_diameter_mm=8.0,
        ),
    ]  # fmt: skip
    scene = lens_scene(surfaces, distance=8.0, sensor_mm=60.0)
    draw = np.random.default_rng(12)
    r = border + draw.choice([-1.0, 1.0], count) * 10.0 ** draw.uniform(-11.0, -1.0, count)
    phi, d = draw.uniform(0.0, 2.0 * np.pi, count), tilted(count, 0.2)
    x, y = r * np.cos(phi), r * np.sin(phi)
    o = np.column_stack([x, y, faces_of(scene)[0].height(x, y)]) - 4.0 * d
    return through_lens(scene, o, d, 1e-10, relative=1e-9)


@case
def two_roots() -> Outcome:
    """Meet the ring-shaped ridge of an asphere with flat rays that cross it up to four times."""
    ridge = Surface(
        radius_mm=-6.0, conic=-1.0, asphere_mm=(1.8e-3,), thickness_mm=8.0, index=1.5, semi_diameter_mm=7.0, stop=True
    )
    scene = lens_scene([ridge, Surface(radius_mm=-60.0, semi_diameter_mm=12.0)], distance=15.0)
    draw = np.random.default_rng(9)
    n = 4000
    # Half of them start outside the ridge, which is 1 mm in front of the vertex, half inside it.
    start, aim = np.where(np.arange(n) < n // 2, 9.0, draw.uniform(0.0, 3.0, n)), draw.uniform(-5.0, 5.0, n)
    phi = draw.uniform(0.0, 2.0 * np.pi, n)
    along = np.column_stack([np.cos(phi), np.sin(phi), draw.uniform(0.0, 0.05, n)])
    o = np.column_stack([-start * np.cos(phi), -start * np.sin(phi), draw.uniform(-1.1, -0.75, n)])
    o[:, :2] += aim[:, None] * np.column_stack([-np.sin(phi), np.cos(phi)])
    face = faces_of(scene)[0]
    # Leave out rays that start behind the surface, and rays that pass beside it.
    r2 = o[:, 0] ** 2 + o[:, 1] ** 2
    d = along / np.linalg.norm(along, axis=1, keepdims=True)
    roots, depth = face.crossings(o, d, 20.0)
    # Within 0.15 mm of the surface, rays may start behind, or pass over, the chords of its coarse mesh.
    chosen = ((r2 > 7.1**2) | (o[:, 2] < face.sag(r2) - 0.15)) & (roots >= 2) & (depth > 0.15)
    o, d, roots = o[chosen], d[chosen], roots[chosen]
    true = face.meet(o, d)
    paths = trace(build(scene), o, d, split="transmit", record=True)
    met = np.full((len(o), 3), np.nan)
    for packet, source in enumerate(paths.source):
        path = paths.vertices(packet)
        if path[1].surface == "lens surface 0":
            met[source] = path[1].position
    lost = np.isin(np.arange(len(o)), paths.source[paths.status == Status.LOST])
    judged = ~lost & (np.hypot(true[:, 0], true[:, 1]) < 7.0)
    error = np.linalg.norm(met - true, axis=1)[judged]
    return outcome(
        paths,
        f"{int(judged.sum())} rays, {int((roots > 2).sum())} of them with four roots, meet the first, to 1e-10 mm",
        f"{int((error < 1e-10).sum())} do, {int(lost.sum())} lost; error {error.max(initial=0.0):.1e} mm",
        len(error) > 1000 and bool((error < 1e-10).all()),
    )  # fmt: skip


@case
def bulges_grazed() -> Outcome:
    """Graze aspheres, spherical to 1e-14 mm, that bulge between the chords of their meshes."""
    spheres, aspheres = (
        lens_scene(
            [
                Surface(radius_mm=7.0, asphere_mm=term, thickness_mm=12.0, index=1.3, semi_diameter_mm=5.9, stop=True),
                Surface(radius_mm=-6.2, asphere_mm=term, semi_diameter_mm=5.9),
            ],
            sensor_mm=1e4, distance=20.0,
        )
        for term in ((), (1e-17,))
    )  # fmt: skip
    draw = np.random.default_rng(0)
    n = 40_000
    d = draw.normal(size=(n, 3))
    # Half of them are nearly perpendicular to the axis.
    d[:, 2] = np.abs(d[:, 2]) * np.where(np.arange(n) < n // 2, 0.2, 2.0)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = np.column_stack([draw.uniform(-6.0, 6.0, (n, 2)), draw.uniform(-3.0, 3.0, n)]) - 40.0 * d
    true = through(faces_of(spheres), o, d)
    return on_sensor(
        trace(build(aspheres), o, d, split="transmit"), at_plane(true.p, true.d, sensor_z(spheres)), true.weight, 1e-9,
        stopped=cut(spheres, true), relative=1e-8,
    )  # fmt: skip


@case
def hyperboloid() -> Outcome:
    """Meet a conic with k < −1 and its second sheet in the rays' path."""
    surfaces = [
        Surface(radius_mm=-8.0, conic=-3.5, thickness_mm=3.0, index=1.7, semi_diameter_mm=10.0, stop=True),
        Surface(radius_mm=40.0, conic=-2.2, semi_diameter_mm=10.0),
    ]
    o, d = _bundle(20_000, 9.9, 0.1)
    return through_lens(lens_scene(surfaces, distance=15.0), o, d, 1e-10)


@case
def oblate() -> Outcome:
    """Meet a conic with k > 0, which ends at its rim."""
    surfaces = [
        Surface(radius_mm=20.0, conic=2.5, thickness_mm=9.0, index=1.6, semi_diameter_mm=10.5, stop=True),
        Surface(radius_mm=-40.0, conic=1.0, semi_diameter_mm=12.0),
    ]
    o, d = _bundle(20_000, 10.45, 0.1)
    return through_lens(lens_scene(surfaces, distance=15.0), o, d, 1e-10)
