"""Refuse motions during which surroundings change, which the tables hold as they are at t = 0.

A packet knows the bodies of glass around it by the surfaces that it crosses, and the tables say once for all in which
body a target, a lamp, a particle or a medium lies. So nothing may pass through a surface of glass while pixels collect
light, and nothing may enter the camera. Both are proven for the whole exposure, see `geometry.motion_contacts`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import combinations

import numpy as np

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.box_corners import corners_between
from lfmesh.geometry.index_media import bends
from lfmesh.geometry.lens.lens_shape import LensShape
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.motion_contacts import MovingSurface, first_contact, moving_surface, swept_box
from lfmesh.geometry.motions import Segments, motions_of
from lfmesh.geometry.objects.primitives import RINGS, hull, primitive
from lfmesh.geometry.objects.refractors import bounding_mesh
from lfmesh.geometry.objects.targets import TargetMesh, named_target
from lfmesh.geometry.rigid_motion import resting, sweep
from lfmesh.scene import Box, Cylinder, Scene, Sphere
from lfmesh.scene.light.particles import particle_velocities, shining_particles
from lfmesh.scene.media.media import MeshBounds
from lfmesh.transport.close_faces import stand_off_mm
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.inside_camera import barrel_of, outline_of
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.tables.bending_fields import FieldMedium
from lfmesh.transport.tables.contacts import CUT
from lfmesh.transport.tables.lens import outermost
from lfmesh.transport.tables.volumes import ROUNDING, Volumes, corners_of

AS_CLOSE = 2.0
"""Distance within which surfaces count as touching, in roundings of float32, beside the contact of glass."""

MEND = "move it, or change motion or exposure.duration_s"


@dataclass(eq=False)
class _Thing:
    """Anything whose surface must stay clear of other surfaces.

    Attributes
    ----------
    name : str
    motion : (n,) SEGMENT
    end_s : float
        End of the exposure.
    made : callable
        Returns the corners (m, 3, 3) of its facets in the world, mm; several sets represent a round surface, on both
        of its sides.
    stand_off_mm : float
        Largest distance of its surface from the facets.
    flows : bool
        Its parts also move on their own.
    """

    name: str
    motion: Segments
    end_s: float
    made: Callable[[], list[Array]]
    stand_off_mm: float = 0.0
    flows: bool = False

    @cached_property
    def facets(self) -> list[Array]:
        """Corners of its facets, (m, 3, 3) each, mm."""
        return self.made()

    @cached_property
    def surfaces(self) -> list[MovingSurface]:
        """The facets of each set as trees."""
        return [moving_surface(corners, self.motion) for corners in self.facets]

    @cached_property
    def box(self) -> Array:
        """Box that holds it throughout, (2, 3) mm."""
        return swept_box(np.concatenate(self.facets), self.motion, 0.0, self.end_s)

    def moves_with(self, other: "_Thing") -> bool:
        """Tell whether both have one motion."""
        return not (self.flows or other.flows) and self.motion.tobytes() == other.motion.tobytes()


def refuse_untraceable_motion(
    scene: Scene, targets: list[TargetMesh], camera: tuple[LensShape, Mesh], moves: Array,
    volumes: Volumes | None, fields: Sequence[FieldMedium],
) -> None:  # fmt: skip
    """Refuse motions through glass, into the camera, or beside media that bend light.

    Parameters
    ----------
    scene : Scene
        Solved.
    targets : list of TargetMesh
        World frame.
    camera : (LensShape, Mesh)
        The lens and the housing, camera frame.
    moves : (6, 6, 3, 4) float64
        See `frame_table`.
    volumes : Volumes or None
        Media.
    fields : sequence of FieldMedium
        Media that bend light.

    Raises
    ------
    SceneError
        Names the objects and the time.
    """
    if scene.exposure is None or not scene.moves:
        return
    end_s, motions = scene.exposure.end_s(scene.camera.sensor.pixels[1]), motions_of(scene)
    still = resting()
    camera_motion = still if motions.camera is None else motions.camera
    bodies = [
        _target(scene, i, target, still if own is None else own, end_s)
        for i, (target, own) in enumerate(zip(targets, motions.bodies, strict=True))
    ]
    lamps = list(_lamps(scene, motions.lights, end_s))
    shape, housing = camera
    lens_front = float(outermost(shape)[:, 2].min())
    media = list(_media(scene, volumes, motions.media, moves, end_s))
    particles = {still.tobytes(): list(_particles(scene, end_s, still))}
    glass = [i for i, target in enumerate(scene.targets) if target.refractor is not None]
    _refuse_moving_fields(scene, motions.camera, motions.media)
    _refuse_other_motion_inside(scene, motions.media, motions.bodies)
    _refuse_glass_in_glass([(bodies[i], targets[i]) for i in glass])
    for i in glass:
        carrier = bodies[i].motion if _carries(bodies[i].motion) else still
        if carrier.tobytes() not in particles:
            particles[carrier.tobytes()] = list(_particles(scene, end_s, carrier))
        grains = particles[carrier.tobytes()]
        for other in (*(each for j, each in enumerate(bodies) if j not in glass or j > i), *lamps, *media, *grains):
            _refuse_contact(bodies[i], other, "nothing may pass through a surface of glass while pixels collect light")
        for field in fields:
            box = _Thing(field.medium.name, camera_motion, end_s, partial(_box_facets, field.medium.corners_mm()))
            _refuse_contact(bodies[i], box, "glass must stay outside a medium that bends light")
    # A lamp between the first vertex and the plane of the rim may be in the first lens.
    for things, front in ((bodies, np.inf), (lamps, 0.0)):
        barrel = _Thing("the camera", camera_motion, end_s, partial(_barrel, housing, front, moves))
        for thing in things:
            _refuse_contact(thing, barrel, "objects must stay outside the camera's barrel")
    for thing in media:
        _refuse_behind(thing, camera_motion, moves, 0.0, "first lens vertex")
    for thing in particles[still.tobytes()]:
        _refuse_behind(thing, camera_motion, moves, lens_front, "front of the lens")


def _refuse_contact(one: _Thing, other: _Thing, rule: str) -> None:
    """Refuse two things that touch during the exposure and do not move as one."""
    if one.moves_with(other):
        return
    near = _near_mm(one, other)
    if (np.maximum(one.box[0] - other.box[1], other.box[0] - one.box[1]) > near).any():
        return
    for surface in one.surfaces:
        for its in other.surfaces:
            time = first_contact(surface, its, 0.0, one.end_s, near)
            if np.isnan(time):
                raise SceneError(
                    f"{one.name} and {other.name} cannot be shown to stay apart during the exposure, as too many of "
                    "their facets are close; leave more room between them, or use coarser meshes"
                )
            if time < np.inf:
                when = f"at t = {time:.4g} s, before the exposure ends at {one.end_s:.4g} s"
                if one.flows or other.flows:
                    when = "during the exposure"
                raise SceneError(f"{one.name} and {other.name} touch {when}; {rule}: {MEND}")


def _near_mm(one: _Thing, other: _Thing) -> float:
    """Return the distance within which two things touch, mm."""
    boxes = np.array([one.box, other.box])
    sizes = [float(np.ptp(np.concatenate(each.facets), axis=(0, 1)).max()) for each in (one, other)]
    grain = AS_CLOSE * FLOAT32_GRAIN * float(np.abs(boxes).sum(axis=2).max() + max(sizes))
    return grain + CUT * min(sizes) + one.stand_off_mm + other.stand_off_mm


def _refuse_glass_in_glass(glass: list[tuple[_Thing, TargetMesh]]) -> None:
    """Refuse bodies of glass inside others that move differently; bodies that touch are refused elsewhere."""
    for (one, body), (other, its) in combinations(glass, 2):
        if one.moves_with(other):
            continue
        pair = (one.name, body), (other.name, its)
        for (name, inner), (around, outer) in (pair, pair[::-1]):
            boxes = outer.box_mm - inner.box_mm
            if (boxes[0] < 0.0).all() and (boxes[1] > 0.0).all() and outer.holds(inner.mesh.vertices).any():
                raise SceneError(
                    f"{name} lies inside {around}, and they move differently; glass inside glass must have the same "
                    "motion: give both one, about the same center_mm"
                )


def _refuse_moving_fields(scene: Scene, camera: Segments | None, motions: Sequence[Segments | None]) -> None:
    """Refuse media that bend light if they move relative to the camera."""
    for i, (medium, motion) in enumerate(zip(scene.media, motions, strict=True)):
        own, its = (b"" if each is None else each.tobytes() for each in (motion, camera))
        if bends(scene, medium) and own != its:
            key = f"media[{i}].motion" if motion is not None else "camera.motion"
            name = f"media[{i}]" + (f" ({medium.name})" if medium.name else "")
            raise SceneError(
                f"{key}: {name} bends light, and must rest relative to the camera; give both the same motion, about "
                "the same center_mm, or none"
            )


def _refuse_other_motion_inside(
    scene: Scene, motions: Sequence[Segments | None], bodies: Sequence[Segments | None]
) -> None:
    """Refuse media that fill a body but have another motion."""
    for i, (medium, motion) in enumerate(zip(scene.media, motions, strict=True)):
        if medium.inside is None or medium.bounds is not None or medium.grid is not None:
            continue
        of_body = bodies[scene.body_named(medium.inside)]
        own, its = (b"" if each is None else each.tobytes() for each in (motion, of_body))
        if own != its:
            raise SceneError(
                f"media[{i}].motion: the medium fills {medium.inside}, which moves otherwise; omit motion, then it "
                "shares that of the body"
            )


def _refuse_behind(thing: _Thing, camera: Segments, moves: Array, front: float, where: str) -> None:
    """Refuse a medium or particles that do not stay in front of a plane of the camera, z = `front` in its frame."""
    if thing.motion.tobytes() == camera.tobytes() and not thing.flows:
        return
    points = np.concatenate(thing.facets).reshape(-1, 3)
    box = corners_between(points.min(axis=0), points.max(axis=0))
    to_z = moves[WORLD_FRAME, CAMERA_FRAME, 2]
    for bounding in (box, points):
        places, margin = sweep(thing.motion, bounding, 0.0, thing.end_s, camera)
        behind = float((places @ to_z[:3]).max() + to_z[3] + margin - front)
        if behind <= ROUNDING * float(np.abs(places).max()):
            return
    raise SceneError(f"{thing.name} may reach {behind:.4g} mm behind the {where} during the exposure; {MEND}")


def _target(scene: Scene, number: int, target: TargetMesh, motion: Segments, end_s: float) -> _Thing:
    def made() -> list[Array]:
        if target.round is None:
            return [target.mesh.vertices[target.mesh.faces]]
        # The mesh lies inside the round surface, the hull outside.
        return [mesh.vertices[mesh.faces] for mesh in (target.mesh, target.round.hull(RINGS))]

    off = 0.0 if target.round is not None else stand_off_mm(scene.targets[number], target.mesh)
    return _Thing(named_target(scene, number), motion, end_s, made, off)


def _lamps(scene: Scene, motions: Sequence[Segments | None], end_s: float) -> Iterator[_Thing]:
    """Yield the lamps that have a place."""
    for i, (light, motion) in enumerate(zip(scene.lights, motions, strict=True)):
        if light.region is not None:
            corners = outline_of(light.region)
            fan = np.array([corners[[0, min(k, len(corners) - 1), min(k + 1, len(corners) - 1)]]
                            for k in range(1, max(len(corners) - 1, 2))])  # fmt: skip
            made = partial(_given, fan)
            yield _Thing(f"lights[{i}].{light.place_in_words}", resting() if motion is None else motion, end_s, made)


def _media(
    scene: Scene, volumes: Volumes | None, motions: Sequence[Segments | None], moves: Array, end_s: float
) -> Iterator[_Thing]:
    """Yield the media that have bounds of their own and do not bend light."""
    for i, (medium, motion) in enumerate(zip(scene.media, motions, strict=True)):
        bounded = medium.bounds is not None or medium.grid is not None
        if volumes is not None and bounded and not bends(scene, medium):
            to_world = frame.compose(moves[OBJECT_FRAME, WORLD_FRAME], frame.inverse(volumes.rows[i]["to_own"]))
            made = partial(_boundary, scene, i, volumes.rows[i], to_world)
            yield _Thing(f"media[{i}]", resting() if motion is None else motion, end_s, made)


def _boundary(scene: Scene, number: int, row: np.void, to_world: Array) -> list[Array]:
    """Return facets that enclose a medium, (m, 3, 3) mm, in the world."""
    bounds = scene.media[number].bounds if row["cells"][0] == 0 else None
    if isinstance(bounds, Sphere | Cylinder):
        mesh = hull(bounds, RINGS)
    elif isinstance(bounds, MeshBounds):
        mesh = bounding_mesh(scene.resolve(str(bounds.file)), bounds.units, bounds.node, bounds.tolerance_mm)
    else:
        corners = corners_of(row)
        return [] if corners is None else _box_facets(frame.points(to_world, corners))
    return [mesh.moved(to_world).vertices[mesh.faces]]


def _box_facets(corners: Array) -> list[Array]:
    """Return the facets of a box from its corners (8, 3), which vary in z first, then in y and x."""
    mesh = primitive(Box(size_mm=(2.0, 2.0, 2.0))).mesh
    number = ((mesh.vertices > 0.0) @ [4, 2, 1]).astype(np.int64)
    return [corners[number][mesh.faces]]


def _carries(motion: Segments) -> bool:
    """Tell whether a body moves at one velocity without a turn, so that particles may be at rest relative to it."""
    return len(motion) == 1 and motion["rate"][0] == 0.0 and bool(motion["velocity"].any())


def _particles(scene: Scene, end_s: float, carrier: Segments) -> Iterator[_Thing]:
    """Yield the particles of each entry, as segments along which they move relative to a body that does not turn."""
    for i, group in enumerate(scene.particles):
        points, _ = shining_particles(group, scene)
        velocity = particle_velocities(group, points, scene)
        relative = (0.0 if velocity is None else velocity) - carrier["velocity"][0]
        ends = points + end_s * relative
        if len(points):
            made = partial(_given, np.stack([points, ends, ends], axis=1))
            yield _Thing(f"particles[{i}]", carrier, end_s, made, flows=bool((ends != points).any()))


def _given(corners: Array) -> list[Array]:
    return [corners]


def _barrel(housing: Mesh, front: float, moves: Array) -> list[Array]:
    """Return the facets of a cylinder round the camera's barrel, (m, 3, 3) mm in the world; `front` : its largest z."""
    radius, first, end = barrel_of(housing)
    first = min(first, front)
    mesh = hull(Cylinder(radius_mm=radius, height_mm=end - first), RINGS)
    in_camera = frame.frame((0.0, 0.0, 0.0), (0.0, 0.0, 0.5 * (first + end)))
    return [mesh.moved(frame.compose(moves[CAMERA_FRAME, WORLD_FRAME], in_camera)).vertices[mesh.faces]]
