"""Gradient-index glass: long rods, rays along edges and turning points, balls of Luneburg, faint gradients."""

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from lfmesh.accuracy.hard.outcome import Outcome, case, disk, lens_scene, on_sensor, outcome, through_lens, tilted
from lfmesh.accuracy.hard.truth import Array
from lfmesh.scene import Surface
from lfmesh.scene.camera.gradient import AnyGradient, AxialGradient, RadialSquareGradient, SphericalGradient
from lfmesh.transport.build import build
from lfmesh.transport.trace import Status, trace

TOLERANCE_MM = 2e-9
"""Of landing points. The steps through the glass are made for 1e-9 mm."""

INDEX, SQUARE = 1.6, -0.09
"""n² = INDEX² (1 + SQUARE r²) of the rods."""
PITCH_MM = 2.0 * np.pi / np.sqrt(-SQUARE)
ROD = RadialSquareGradient(index=INDEX, coefficients=(SQUARE,))


def _plate(gradient: AnyGradient, length: float, semi: float) -> list[Surface]:
    """Return flat faces with a gradient between them."""
    return [
        Surface(thickness_mm=length, semi_diameter_mm=semi, stop=True, gradient=gradient),
        Surface(semi_diameter_mm=semi),
    ]


@case
def rod_of_ten_pitches() -> Outcome:
    """Cross a rod ten pitches long with skew rays."""
    d = tilted(2000, 0.4)
    o = np.column_stack([disk(0.8, 2000), np.zeros(2000)]) - 2.0 * d
    scene = lens_scene(_plate(ROD, 10.0 * PITCH_MM, 2.0), distance=1.0, sensor_mm=20.0)
    # Ten times as long as the glass that rays cross in one pitch, with ten times the error.
    return through_lens(scene, o, d, 10.0 * TOLERANCE_MM, relative=1e-8)


@case
def along_the_edge_of_a_rod() -> Outcome:
    """Pass the edge of a rod at 1e-3 to 1e-8 mm, inside and outside."""
    count, semi = 2000, 1.5
    scene = lens_scene(_plate(ROD, 0.4 * PITCH_MM, semi), distance=0.5, sensor_mm=20.0)
    world = build(scene)
    # The glass is a little wider than the clear apertures of its faces.
    edge = float(world.lens_shape.rims[0])
    draw = np.random.default_rng(3)
    beside = 10.0 ** draw.uniform(-8.0, -3.0, count)
    inside = draw.uniform(size=count) < 0.5
    farthest = np.where(inside, edge - beside, edge + beside)
    # The path is an ellipse: half a pitch has its largest distance from the axis, here beside the points of the start.
    turn, nearest = draw.uniform(0.0, 2.0 * np.pi, count), draw.uniform(0.0, 0.9, count)
    where = draw.uniform(0.2, 0.4, count) * np.pi
    rate = INDEX * np.sqrt(-SQUARE)
    first = np.column_stack([np.cos(turn), np.sin(turn)])
    second = np.column_stack([-np.sin(turn), np.cos(turn)])
    at = (farthest * np.sin(where))[:, None] * first + (nearest * np.cos(where))[:, None] * second
    sines = rate * ((farthest * np.cos(where))[:, None] * first - (nearest * np.sin(where))[:, None] * second)
    d = np.column_stack([sines, np.sqrt(1.0 - (sines**2).sum(axis=1))])
    o = np.column_stack([at, np.zeros(count)]) - d
    paths = trace(world, o, d, split="transmit")
    came = np.zeros(count, dtype=bool)
    came[paths.source[(paths.status == Status.SENSOR) | (np.array(paths.body) == "beside the sensor")]] = True
    wrong, lost = int((came != inside).sum()), int((paths.status == Status.LOST).sum())
    return outcome(
        paths, f"{int(inside.sum())} of {count} rays pass, the others end on the edge",
        f"{int(came.sum())} pass, {wrong} end wrongly, {lost} lost", wrong == 0 and lost == 0,
    )  # fmt: skip


@case
def turning_before_the_back_face() -> Outcome:
    """Send rays towards ever lower indices, with n sin α from 0.1 to 1e-6 below and above the index behind."""
    count, length, front, back = 2000, 4.0, 1.8, 1.4
    draw = np.random.default_rng(5)
    beside = 10.0 ** draw.uniform(-6.0, -1.0, count)
    reaches = draw.uniform(size=count) < 0.5
    sine = np.where(reaches, back - beside, back + beside) / front
    turn = draw.uniform(0.0, 2.0 * np.pi, count)
    d = np.column_stack([sine * np.cos(turn), sine * np.sin(turn), np.sqrt(1.0 - sine**2)])
    falling = AxialGradient(index=front, coefficients=((back - front) / length,))
    scene = lens_scene(_plate(falling, length, 60.0), distance=1.0).changed(
        {"camera.object_medium": {"index": front}, "camera.image_medium": {"index": front}}
    )
    paths = trace(build(scene), -0.1 * d, d, split="transmit")
    came = np.zeros(count, dtype=bool)
    came[paths.source[(paths.status == Status.SENSOR) | (np.array(paths.body) == "beside the sensor")]] = True
    wrong, lost = int((came != reaches).sum()), int((paths.status == Status.LOST).sum())
    return outcome(
        paths, f"{int(reaches.sum())} of {count} rays reach the back face, the others turn round",
        f"{int(came.sum())} reach it, {wrong} end wrongly, {lost} lost", wrong == 0 and lost == 0,
    )  # fmt: skip


@case
def ball_of_luneburg() -> Outcome:
    """Gather parallel light in a point of the rim of a ball, from nine tenths of its width."""
    count, radius = 5000, 4.0
    # n = √(2 − ρ²/R²) as a polynomial of the depth below the rim, to rounding.
    fit = Chebyshev.interpolate(lambda t: np.sqrt(2.0 - (1.0 - t) ** 2), 22, [0.0, 1.0]).convert(kind=Polynomial)
    coefficients = tuple(float(c) / radius**i for i, c in enumerate(fit.coef))
    gradient = SphericalGradient(index=1.0, coefficients=coefficients[1:], radius_mm=radius)
    semi = 0.95 * radius
    surfaces = [
        Surface(radius_mm=radius, thickness_mm=2.0 * radius, semi_diameter_mm=semi, stop=True, gradient=gradient),
        Surface(radius_mm=-radius, semi_diameter_mm=semi),
    ]
    o = np.column_stack([disk(0.9 * radius, count), np.full(count, -1.0)])
    d = np.tile([0.0, 0.0, 1.0], (count, 1))
    scene = lens_scene(surfaces, distance=1e-3, sensor_mm=1.0)
    paths = trace(build(scene), o, d, split="transmit", record=True)
    met = [v.position for k in range(len(paths)) for v in paths.vertices(k) if v.surface == "lens surface 1"]
    error = np.linalg.norm(np.array(met) - [0.0, 0.0, 2.0 * radius], axis=1).max(initial=0.0) if met else np.inf
    lost = int((paths.status == Status.LOST).sum())
    return outcome(
        paths, f"{count} rays in one point, within {TOLERANCE_MM:.0e} mm, without reflection",
        f"{len(met)} rays, {lost} lost; error {error:.1e} mm, of the weight {np.abs(paths.weight - 1.0).max():.1e}",
        len(met) == count and lost == 0 and bool(error < TOLERANCE_MM and np.abs(paths.weight - 1.0).max() < 1e-12),
    )  # fmt: skip


@case
def faint_gradient() -> Outcome:
    """Compare a gradient of 1e-14 with homogeneous glass."""
    d = tilted(5000, 0.3)
    o = np.column_stack([disk(2.5, 5000), np.zeros(5000)]) - 5.0 * d
    faint = RadialSquareGradient(index=1.7, coefficients=(-1e-14,))

    def lens(**glass: object) -> list[Surface]:
        first = {"radius_mm": 9.0, "thickness_mm": 4.0, "semi_diameter_mm": 3.0, "stop": True, **glass}
        return [Surface.model_validate(first), Surface(radius_mm=-12.0, semi_diameter_mm=3.0)]

    plain, graded = (
        trace(build(lens_scene(lens(**glass), distance=5.0)), o, d, split="transmit")
        for glass in ({"index": 1.7}, {"gradient": faint})
    )
    there = plain.status == Status.SENSOR
    truth, weight = np.full((len(o), 3), np.nan), np.full(len(o), np.nan)
    truth[plain.source[there]], weight[plain.source[there]] = plain.position[there], plain.weight[there]
    stopped = np.ones(len(o), dtype=bool)
    stopped[plain.source[there]] = False
    truth[stopped], weight[stopped] = 0.0, 1.0
    return on_sensor(graded, truth, weight, 1e-11, stopped=stopped, relative=1e-11)


@case
def face_between_gradients_of_one_index() -> Outcome:
    """Cross a curved face with the same index on both sides, as in the lens of an eye."""

    # Both halves have n = 1.42 − 0.02 (z/2)² − 0.01 r² about the vertex of the face between them.
    def half(start: float) -> Array:
        return np.array([1.42 - 0.005 * start**2, -0.01 * start, -0.005])

    (front, *rise), (middle, *fall) = half(-2.0).tolist(), half(0.0).tolist()
    base = {"kind": "radial_n", "coefficients": [-0.01]}
    surfaces = [
        Surface.model_validate({"radius_mm": 12.0, "thickness_mm": 2.0, "semi_diameter_mm": 2.5, "stop": True,
                                "gradient": base | {"index": front, "axial_coefficients": rise}}),
        Surface.model_validate({"radius_mm": -20.0, "thickness_mm": 3.0, "semi_diameter_mm": 2.5,
                                "gradient": base | {"index": middle, "axial_coefficients": fall}}),
        Surface(radius_mm=-8.0, semi_diameter_mm=2.5),
    ]  # fmt: skip
    d = tilted(5000, 0.2)
    o = np.column_stack([disk(1.8, 5000), np.zeros(5000)]) - 3.0 * d
    return through_lens(lens_scene(surfaces, distance=4.0), o, d, TOLERANCE_MM, relative=1e-8)


@case
def gradient_behind_a_strong_asphere() -> Outcome:
    """Bend rays between aspheres that are inclined by up to 40 degrees, in a steep radial gradient."""
    surfaces = [
        Surface(
            radius_mm=6.0, conic=-0.8, asphere_mm=(2e-4, 1e-5), thickness_mm=6.0, semi_diameter_mm=3.5, stop=True,
            gradient=RadialSquareGradient(index=1.7, coefficients=(-0.02, 1e-4)),
        ),
        Surface(radius_mm=-9.0, conic=-2.0, asphere_mm=(3e-4,), semi_diameter_mm=3.5),
    ]  # fmt: skip
    d = tilted(5000, 0.2)
    o = np.column_stack([disk(3.2, 5000), np.zeros(5000)]) - 20.0 * d
    return through_lens(lens_scene(surfaces, distance=1.0), o, d, TOLERANCE_MM, relative=1e-8)
