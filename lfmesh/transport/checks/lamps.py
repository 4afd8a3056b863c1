"""Warnings about lamps in the field, or close to a target."""

from collections.abc import Iterator

import numpy as np

from lfmesh.errors import HeavyPathsWarning, MissedLightWarning, PictureWarning
from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array, distance_mm
from lfmesh.geometry.objects.targets import named_target
from lfmesh.scene.advice import half_field_mm
from lfmesh.scene.light.lights import DirectionalLight, DiskLight
from lfmesh.scene.literals import plain
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.world import World

ENOUGH_ON_SPOT = 20.0
"""Samples, weighted by their light, in the spot that a lamp close to a target lights: with 26 the stated error held the
truth within twice its size in 96 of 100 runs, with 7 in 85, with 1 in 60."""


def lamps_in_field(world: World) -> Iterator[PictureWarning]:
    """Name lamps that the camera looks at: no ray meets them, and few paths find a disk lamp in fog."""
    scatters = any(medium.may_scatter for medium in world.scene.media)
    for number, light in enumerate(world.scene.lights):
        if isinstance(light, DirectionalLight):
            continue
        (place,) = frame.points(world.tables.frames[WORLD_FRAME, CAMERA_FRAME], np.array([light.position_mm]))
        beside = light.radius_mm if isinstance(light, DiskLight) else 0.0
        if not place[2] < 0.0 or (np.abs(place[:2]) - beside > half_field_mm(float(place[2]), world.first_order)).any():
            continue
        if _hides(world, np.array(light.position_mm)):
            continue
        yield MissedLightWarning(
            f"lights[{number}] stands in the field: lamps light targets, but are not seen, and the picture lacks its "
            "own image; a target with radiance_w_m2_sr in its place is seen"
        )
        if scatters and isinstance(light, DiskLight):
            yield HeavyPathsWarning(
                f"lights[{number}], a disk, stands in the field of a scene with media that scatter. Where lines of "
                "sight cross the plane of the disk, few paths bring much of the light, and errors and upper bounds of "
                "single pixels are too small. Take many more samples, or a point lamp"
            )


def _hides(world: World, point: Array) -> bool:
    """Tell whether an opaque target stands between a point and the first vertex of the lens."""
    (eye,) = frame.points(world.tables.frames[CAMERA_FRAME, WORLD_FRAME], np.zeros((1, 3)))
    along = eye - point
    for number, body in enumerate(world.targets):
        if world.scene.targets[number].refractor is not None or body.alpha is not None:
            continue
        a, b, c = np.moveaxis(body.mesh.vertices[body.mesh.faces], 1, 0)
        # Moeller and Trumbore 1997: shares of the edges, and of the way, at which the facets' planes are met.
        across = np.cross(along, c - a)
        scale = np.einsum("ij,ij->i", b - a, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ij,ij->i", point - a, across) / scale
            other = np.cross(point - a, b - a)
            v = other @ along / scale
            way = np.einsum("ij,ij->i", c - a, other) / scale
            met = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (way > 0.0) & (way < 1.0)
        if met.any():
            return True
    return False


def lamps_at_targets(world: World) -> Iterator[PictureWarning]:
    """Name lamps so close to a target in the field that few paths from the pixels come to the spot that they light.

    A point lamp at a height h lights its target by h/(h² + r²)^(3/2). Of samples that are spread evenly with a density
    d this is as well known as by 8π h² d samples of equal light.
    """
    transport = world.scene.transport
    if transport.method != "adjoint":
        return
    columns, rows = world.scene.camera.sensor.pixels
    samples = columns * rows * transport.samples_each * transport.replicates
    for number, light in enumerate(world.scene.lights):
        if isinstance(light, DirectionalLight):
            continue
        (place,) = frame.points(world.tables.frames[WORLD_FRAME, CAMERA_FRAME], np.array([light.position_mm]))
        half = np.array(half_field_mm(float(place[2]), world.first_order))
        size = light.radius_mm if isinstance(light, DiskLight) else 0.0
        reach = np.sqrt(ENOUGH_ON_SPOT / (8.0 * np.pi * samples) * 4.0 * half.prod())
        if not place[2] < 0.0 or size > reach or (np.abs(place[:2]) - reach > half).any():
            continue
        for target, body in enumerate(world.targets):
            near = _distance_mm(body.mesh.vertices[body.mesh.faces], np.array(light.position_mm), reach)
            if world.scene.targets[target].refractor is None and near < reach:
                yield HeavyPathsWarning(
                    f"lights[{number}] stands {plain(near, 2)} mm from {named_target(world.scene, target)}, of which "
                    "few samples meet the spot that it lights. The picture may be too dark, and its error too small. "
                    f'Move the lamp {plain(reach, 2)} mm or more away, take more samples, or method = "forward"'
                )


def _distance_mm(corners: Array, point: Array, reach: float) -> float:
    """Return the distance of a point from the nearest of some facets; inf beyond a reach of all their boxes."""
    near = ((corners.min(axis=1) <= point + reach) & (corners.max(axis=1) >= point - reach)).all(axis=1)
    return distance_mm(corners[near], point)
