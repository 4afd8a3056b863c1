"""Places of a scene's targets as the camera sees them: boxes, distances, share of the field, and warnings.

All meshes and pictures are loaded. No ray is traced, so occlusion does not count.
"""

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LensFileWarning
from lfmesh.geometry import frame
from lfmesh.geometry.files.contents import counted, held
from lfmesh.geometry.files.mesh_file import UNIT_OF_FORMAT, load_mesh
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.meshes.mesh import Array, facet_normals
from lfmesh.geometry.objects.targets import TargetMesh, is_met_exactly, named_target, target_mesh
from lfmesh.scene import FirstOrder, Scene, Target
from lfmesh.scene.advice import half_field_mm
from lfmesh.scene.first_order.paraxial import quotient
from lfmesh.scene.light.lights import Light
from lfmesh.scene.motion import at_begin
from lfmesh.scene.quantities import SMALLEST

LARGE_MM = 1000.0
"""Size above which a mesh file that overfills the field is suspected of a wrong unit."""

MOST_NAMED = 8
"""Largest number of lamps named as lighting a target."""

MOST_SEEN = 4.0
"""Ratio of a body's size to the width of the field from which its unit is suspected."""


HIDES = "encloses the camera: its inside is black, and hides everything else"
"""Warning about an opaque body."""


@dataclass(frozen=True)
class Placement:
    """Place of a target.

    Attributes
    ----------
    name : str
        Path in the scene file, and its own name or file.
    low, high : (3,) float64
        Corners of its box in the world, mm.
    nearest_mm, farthest_mm : float
        Axial distances of its ends in front of the first vertex; negative behind it.
    share : float
        Fraction of the field of view filled by the box round its picture, 0..1.
    facets : int
        Number of facets; 0 if rays meet its exact round surface.
    picture : tuple of int, or None
        Width and height of its texture.
    lit_by : tuple of str, or None
        Lamps in front of a visible side that shine towards it. None if no side is visible or the target is of glass.
    contents : str
        Element counts of its mesh file, and of the part loaded where they differ; "" if not counted.
    warnings : tuple of str
    """

    name: str
    low: Array
    high: Array
    nearest_mm: float
    farthest_mm: float
    share: float
    facets: int
    picture: tuple[int, int] | None
    lit_by: tuple[str, ...] | None
    contents: str
    warnings: tuple[str, ...]

    def lines(self) -> list[str]:
        """Describe the place in lines of text, warnings last as notes."""
        box = ", ".join(
            f"{axis} {low:.5g} to {high:.5g}" for axis, low, high in zip("xyz", self.low, self.high, strict=True)
        )
        texture = f", texture {self.picture[0]} × {self.picture[1]}" if self.picture else ""
        lamps = [] if self.lit_by is None else [f"  lit by               {_named(self.lit_by) or 'no lamp'}"]
        return [
            f"{self.name}: {f'{self.facets} facets' if self.facets else 'exact'}{texture}",
            *([f"  its file holds       {self.contents}"] if self.contents else []),
            f"  box in the world     {box} mm",
            f"  before the lens      {self.nearest_mm:.5g} mm to {self.farthest_mm:.5g} mm",
            f"  share of the field   {100 * self.share:.3g} % at most",
            *lamps,
            *(f"Note: {self.name} {text}" for text in self.warnings),
        ]


def _named(lamps: tuple[str, ...]) -> str:
    """Return the names of the first lamps, and the number of the others."""
    more = len(lamps) - MOST_NAMED
    return ", ".join(lamps[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def placements(scene: Scene) -> list[Placement]:
    """Load every target of a scene and locate it.

    Raises
    ------
    LfmeshError
        The scene cannot be solved, or a mesh or picture cannot be used.
    """
    camera = solved_camera(scene)
    return [_placement(camera.scene, camera.report, number) for number in range(len(camera.scene.targets))]


def _placement(scene: Scene, facts: FirstOrder, number: int) -> Placement:
    target = scene.targets[number]
    body = target_mesh(target, scene)
    pose = scene.camera.pose
    to_camera = frame.inverse(frame.frame(pose.tilt_deg, pose.shift_mm))
    corners = body.mesh.vertices[np.unique(body.mesh.faces)]
    seen = frame.points(to_camera, corners)
    facets = frame.points(to_camera, body.mesh.vertices[body.mesh.faces].reshape(-1, 3)).reshape(-1, 3, 3)
    before = _before_the_camera(facets)
    share = share_of_field(in_field(before, facts)) if len(before) else 0.0
    lit_by = _lamps(scene, target, body, frame.inverse(to_camera)) if share else None
    found = _warnings(scene, facts, target, body, seen, share, lit_by)
    return Placement(
        named_target(scene, number),
        corners.min(axis=0),
        corners.max(axis=0),
        float(-seen[:, 2].max()),
        float(-seen[:, 2].min()),
        share,
        0 if is_met_exactly(target, scene) else len(body.mesh.faces),
        (body.texture.shape[1], body.texture.shape[0]) if body.texture is not None else None,
        lit_by,
        _contents(scene, target),
        tuple(at_begin(text, target, scene.camera, *scene.lights) for text in found),
    )


def _before_the_camera(facets: Array) -> Array:
    """Return corners (n, 3) of the parts of facets (m, 3, 3) in front of the first vertex, camera frame, mm.

    As the half-width of the field is convex in z, a facet reaches no further into the field than its corners, and lies
    outside if all of them are beyond one edge.
    """
    start, end = facets.reshape(-1, 3), np.roll(facets, -1, axis=1).reshape(-1, 3)
    passes = (start[:, 2] < 0.0) != (end[:, 2] < 0.0)
    start, end = start[passes], end[passes]
    at = start + (start[:, 2:] / (start[:, 2:] - end[:, 2:])) * (end - start)
    at[:, 2] = 0.0
    corners = facets.reshape(-1, 3)
    return np.concatenate([corners[corners[:, 2] < 0.0], at])


def _contents(scene: Scene, target: Target) -> str:
    """Return the element counts of a target's mesh file, and of the part loaded where they differ."""
    if target.file is None or (told := counted(scene.resolve(target.file), target.node)) is None:
        return ""
    with warnings.catch_warnings():
        # These warnings were given when the target was made.
        warnings.simplefilter("ignore", LensFileWarning)
        read = held(load_mesh(scene.resolve(target.file), target.units))
    return f"{told}" if read == told else f"{told}; read are {read}: see the warnings"


def _warnings(
    scene: Scene, facts: FirstOrder, target: Target, body: TargetMesh, seen: Array, share: float,
    lit_by: tuple[str, ...] | None,
) -> Iterator[str]:  # fmt: skip
    """Yield likely mistakes in a target's placement; `seen` are its corners in the camera frame, mm."""
    # The first-order report locates shapes itself, unless the camera has moved.
    told = target.shape is not None and not any(scene.camera.pose.shift_mm) and not any(scene.camera.pose.tilt_deg)
    low, high = seen.min(axis=0), seen.max(axis=0)
    size = float((high - low).max())
    to_world = frame.frame(scene.camera.pose.tilt_deg, scene.camera.pose.shift_mm)
    yield from _size(target, facts, size, float(frame.points(frame.inverse(to_world), [target.position_mm])[0, 2]))
    eye = frame.points(to_world, np.zeros((1, 3)))[0]
    if low[2] >= 0.0:
        if low[2] > _sensor_z_mm(scene):
            yield (
                f"stands behind the sensor, from z = {low[2]:.5g} mm on in the camera frame; the camera looks along -z"
            )
        elif not told:
            yield "stands behind the first vertex of the lens, where the camera does not look"
        return
    if is_round(body, eye):
        yield HIDES if target.refractor is None else "encloses the camera, which stands in its glass"
        return
    if share == 0.0:
        if not told:
            yield "is out of the field: no part of it is seen"
        return
    if target.refractor is not None:
        return
    if lit_by is None:
        if target.material.sides == "front" and not body.closed:
            yield 'shows the camera its black side: sides = "front", but its front faces away; turn it around'
    elif _shines(target):
        return
    elif _is_black(target, body):
        zero = "texture" if target.material.reflectance else "reflectance"
        yield f"reflects and emits nothing: its {zero} is 0"
    elif not lit_by and scene.lights and not any(_shines(other) for other in scene.targets):
        yield "is lit by no lamp on the side that the camera sees: only light from other bodies can reach it"


def _size(target: Target, facts: FirstOrder, size_mm: float, z_mm: float) -> Iterator[str]:
    """Suspect the unit of a mesh file if its body is huge, or too small for the camera to resolve."""
    file = target.file if target.refractor is None else target.refractor.file
    if file is None or z_mm >= 0.0:
        return
    half = half_field_mm(z_mm, facts)
    unit = target.units if target.refractor is None else target.refractor.units
    fixed = UNIT_OF_FORMAT.get(Path(file).suffix.lower())
    of_file = f"by the unit of its format, {fixed}," if fixed else "by the unit of its file,"
    what = f"with units = {unit!r}," if unit else of_file
    remedy = "check the unit"
    if target.scale is not None:
        what, remedy = f"{what} with scale = {target.scale:g}", "check the scale"
    elif not unit:
        remedy = "if its numbers are in mm, give the target scale = 0.001" if size_mm > LARGE_MM else "give it a scale"
    if size_mm > LARGE_MM and size_mm > 2.0 * MOST_SEEN * max(half):
        yield (f"is {1e-3 * size_mm:.4g} m wide {what} but the camera sees {2e-3 * max(half):.3g} m there; {remedy}")
    # A sample grows along chief rays as the field does.
    sample = facts.object_sampling_mm * quotient(facts.field.size_mm(z_mm)[1], facts.field_of_view_mm[1])
    if 0.0 < size_mm < sample < math.inf:
        yield f"is {size_mm:.3g} mm wide {what} less than a sample of the picture there; {remedy}"


def _sensor_z_mm(scene: Scene) -> float:
    """Return z of a solved camera's sensor in the camera frame, mm."""
    camera = scene.camera
    z = camera.lens.vertices_mm[-1] + (camera.sensor.distance_mm or 0.0)
    return z + ((camera.mla.distance_mm or 0.0) + camera.mla.thickness_mm if camera.mla is not None else 0.0)


def is_round(body: TargetMesh, eye: Array) -> bool:
    """Tell whether a closed body without transparency surrounds the camera's first vertex."""
    if not body.closed or body.alpha is not None:
        return False
    return bool(body.holds(eye[None])[0])


def in_field(points: Array, facts: FirstOrder) -> Array:
    """Return (n, 2) positions in the field, its edges at ±1, of camera-frame points in front of the lens."""
    z, which = np.unique(points[:, 2], return_inverse=True)
    half = np.array([half_field_mm(float(depth), facts) for depth in z]).reshape(-1, 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(points[:, :2] / half[which], nan=0.0)


def share_of_field(picture: Array) -> float:
    """Return the fraction of the field filled by the box round a picture."""
    low, high = np.clip(picture.min(axis=0), -1.0, 1.0), np.clip(picture.max(axis=0), -1.0, 1.0)
    if (picture.min(axis=0) > 1.0).any() or (picture.max(axis=0) < -1.0).any():
        return 0.0
    return float(np.prod(high - low) / 4.0)


def _facets_in_front(body: TargetMesh, scene: Scene) -> tuple[Array, Array, Array]:
    """Return world-frame centres, normals and radii of the facets that reach in front of the camera.

    A facet counts if one of its corners is in front of the first vertex.
    """
    pose = scene.camera.pose
    normals, areas = facet_normals(body.mesh)
    corners = body.mesh.vertices[body.mesh.faces]
    centres = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    z = frame.points(frame.inverse(frame.frame(pose.tilt_deg, pose.shift_mm)), corners.reshape(-1, 3))[:, 2]
    front = (z.reshape(-1, 3).min(axis=1) < 0.0) & (areas > 0.0)
    return centres[front], normals[front], radii[front]


def _shines(target: Target) -> bool:
    return target.refractor is None and target.material.emits


def _is_black(target: Target, body: TargetMesh) -> bool:
    """Tell whether a target scatters no light, by a reflectance of 0 or a black texture."""
    if target.material.gloss is not None or body.materials:
        return False
    return target.material.reflectance == 0.0 or (body.texture is not None and not body.texture.any())


def _lamps(scene: Scene, target: Target, body: TargetMesh, to_world: Array) -> tuple[str, ...] | None:
    """Return the lamps that shine on a visible side of an opaque target; None if no side is visible.

    `to_world` is the transform from the camera frame.
    """
    if target.refractor is not None:
        return None
    eye = frame.points(to_world, np.zeros((1, 3)))[0]
    centres, normals, radii = _facets_in_front(body, scene)
    to_eye = np.einsum("ij,ij->i", normals, eye - centres)
    visible = to_eye > 0.0 if body.closed or target.material.sides == "front" else to_eye != 0.0
    if not visible.any():
        return None
    towards = (normals * np.sign(to_eye)[:, None])[visible]
    return tuple(
        f"lights[{number}] ({light.kind})"
        for number, light in enumerate(scene.lights)
        if _lit(light, centres[visible], towards, radii[visible]).any()
    )


def _lit(light: Light, points: Array, normals: Array, radii: Array) -> NDArray[np.bool_]:
    """Tell for each facet whether a lamp is in front of it and shines towards it.

    Bounding spheres replace facet and lamp: a near miss may count as lit, a lit facet always does.
    """
    region = light.region
    if region is None:
        return np.asarray(normals @ light.axes[2] < 0.0)
    away = points - region.centre_mm
    # A wide lamp reaches what its centre does not.
    before = np.einsum("ij,ij->i", normals, -away) + region.reach_mm(normals) > 0.0
    if light.heading is None:
        return np.asarray(before)
    around, distance = radii + region.size_mm, np.linalg.norm(away, axis=1)
    ahead = away @ light.heading
    off_axis = np.arccos(np.clip(ahead / np.maximum(distance, SMALLEST), -1.0, 1.0))
    half = np.arcsin(np.minimum(1.0, around / np.maximum(distance, SMALLEST)))
    half[around >= distance] = np.pi
    one_sided = light.spread_deg <= RIGHT_DEG
    return np.asarray(
        before & (off_axis - half <= math.radians(light.spread_deg)) & ((ahead + radii > 0.0) | (not one_sided))
    )


RIGHT_DEG = 90.0
