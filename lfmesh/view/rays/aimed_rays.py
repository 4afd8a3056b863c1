"""Real rays from field points through chosen points of the stop, for layout drawings.

`lf.trace` traces every ray through the built world. Its start comes from ray aiming at the stop (`StopAim`) or, where
surfaces are facets or glass stands before the lens, from a fan of trial rays. Positions are in the camera frame, mm.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.surfaces.bends import rim_range
from lfmesh.geometry.surfaces.sag import gradients, heights
from lfmesh.optics.ray_aiming import aim_rays
from lfmesh.transport.packets.packet import BACK_FACE, CAMERA_FRAME, CURVED_FACE, WORLD_FRAME
from lfmesh.transport.tables.gradient_spaces import has_gradients
from lfmesh.transport.trace import Status, trace
from lfmesh.transport.world import World
from lfmesh.view.rays.gradient_cells import array_face, cells_at
from lfmesh.view.rays.gradient_segments import NO_FACE, Vertices, curves_of, gradient_segments, line_of
from lfmesh.waves.stop_aim import INSIDE, StopAim

Array = NDArray[np.float64]

FAN = 33
"""Trial rays across the pupil for the first guess where lens surfaces have no formulas."""

FAN_WIDTH = 1.6
"""Width of the fan relative to the paraxial entrance pupil, as real pupils have aberrations."""

ROUNDING = 8.0 * float(np.finfo(np.float64).eps)
"""Rounding error of a vanishing sum, relative to its terms."""

DIFFERENCE = 1e-5
"""Step of finite differences between two trial rays, relative to the stop's radius."""


@dataclass(frozen=True)
class AimedRay:
    """Single ray, vertex by vertex.

    Attributes
    ----------
    points : (m, 3) float64, mm
        From its object point (or a plane before the lens, if that is far away) to its end.
    at_stop : (2,) float64, mm
        x and y at the stop surface; NaN if it ends before.
    leaving : (2, 3) float64
        Position on the last lens surface and unit direction behind it; NaN if it does not get there.
    status : Status
        How it ended.
    face, event : (m,) int64
        Face of lens or array at each point, see `gradient_segments`, and the event there.
    line : (k, 3) float64, mm
        The points, with others along curves in gradient-index glass.
    """

    points: Array
    at_stop: Array
    leaving: Array
    status: Status
    face: NDArray[np.int64]
    event: NDArray[np.int64]
    line: Array

    def beyond_lens(self, z: float) -> Array:
        """Return x and y (2,), mm, where the extended ray behind the lens crosses a plane."""
        position, direction = self.leaving
        return np.asarray(position[:2] + (z - position[2]) / direction[2] * direction[:2])


class Aim:
    """Aiming of rays from one object plane through a camera.

    Parameters
    ----------
    world : World
    distance_mm : float
        Distance of the object plane before the first vertex; inf: collimated bundles; negative: a virtual object. The
        stop must not be imaged onto it.
    """

    def __init__(self, world: World, distance_mm: float) -> None:
        self.world = world
        self.wavelength_nm = world.scene.primary_nm
        self.vergence = 1.0 / distance_mm
        self.lens = world.scene.camera.lens
        self.paraxial = solved_camera(world.scene).paraxial
        self.stop_radius = self.lens.surfaces[self.paraxial.stop].semi_diameter_mm or math.nan
        real = 0.0 < distance_mm < math.inf
        self.start_z = -distance_mm if real else -2.0 * (self.paraxial.length_mm + max(world.lens_shape.rims))
        shape = world.lens_shape
        self._names = [world.surface_name(k) for k in range(len(shape.surfaces))]
        self._faces = {name: k for k, name in enumerate(self._names)}
        for number in (CURVED_FACE, BACK_FACE):
            self._faces[world.surface_name(number)] = array_face(world, is_curved=number == CURVED_FACE)
        self._before_stop = sum(number < self.paraxial.stop for number in shape.numbers)
        self._pure_stop = self.lens.is_pure_stop(self.paraxial.stop)
        self._into_stop = frames.inverse(pose_of(self.lens, self.paraxial.stop))
        self._stop_aim = StopAim(world, self.vergence)

    def through(self, slope: ArrayLike, stop: ArrayLike) -> list[AimedRay]:
        """Return the rays from object points through points of the stop.

        Rays blocked by the lens before the stop start in line with their neighbours and end where they are blocked.

        Parameters
        ----------
        slope : (n, 2) float64
            x and y of the object points over their distance from the first vertex.
        stop : (n, 2) float64
            Points of the stop, in units of its radius.
        """
        slope = np.asarray(slope, dtype=np.float64).reshape(-1, 2)
        aim = np.asarray(stop, dtype=np.float64).reshape(-1, 2) * (self.stop_radius * INSIDE)
        return self._with_curves(self._aimed(slope, aim, self._guess(slope, aim))[0])

    def slopes_to(self, targets: ArrayLike, stop: ArrayLike = (0.0, 0.0)) -> Array:
        """Return the slopes (n, 2) of object points with rays that meet targets in the air behind the lens.

        If the lens passes no such ray, the slope is paraxial.

        Parameters
        ----------
        targets : (n, 3) float64, mm
        stop : (n, 2) or (2,) float64
            Point of the stop for each ray, relative to its radius; by default the chief rays.
        """
        targets = np.asarray(targets, dtype=np.float64).reshape(-1, 3)
        stop = np.broadcast_to(np.asarray(stop, dtype=np.float64), (len(targets), 2))
        scale = self._image_scale(targets[:, 2])
        first = targets[:, :2] / scale[:, None]
        aim = stop * (self.stop_radius * INSIDE)
        # A re-aimed ray enters near its previous entry.
        known_slope, known_entry = first.copy(), self._guess(first, aim)

        def landing(slope: Array, which: NDArray[np.int64]) -> Array:
            guess = known_entry[which] + self._entry_shift * (slope - known_slope[which])
            rays, entry = self._aimed(slope, aim[which], guess)
            known_slope[which], known_entry[which] = slope, entry
            hit = [ray.beyond_lens(z) for ray, z in zip(rays, targets[which, 2], strict=True)]
            return np.array(hit).reshape(-1, 2)

        aimed = aim_rays(landing, targets[:, :2], first, scale[:, None, None] * np.eye(2), np.abs(scale))
        return np.where(np.isfinite(aimed.start), aimed.start, first)

    @property
    def _entry_shift(self) -> float:
        """Paraxial shift of a ray's entry point per unit slope, for a fixed point of the stop, mm."""
        return self._stop_by_slope / self._stop_by_entry

    @cached_property
    def _stop_by_entry(self) -> float:
        """Paraxial height at the stop of a ray from an object point, per unit height at the first vertex."""
        straight, turned = self.paraxial.to_stop.a, self._stop_by_slope * self.vergence
        if abs(straight + turned) <= ROUNDING * (abs(straight) + abs(turned)):
            raise LfmeshError(
                "the stop is imaged onto the object plane: all rays of an object point meet the stop at one point, so "
                "they cannot be aimed across it; mark another surface as the stop"
            )
        return straight + turned

    @property
    def _stop_by_slope(self) -> float:
        """Paraxial height at the stop of a ray from the first vertex, per unit slope before the lens."""
        return self.paraxial.indices[0] * self.paraxial.to_stop.b

    def _image_scale(self, z: Array) -> Array:
        """Return the paraxial shift in planes z per unit slope, for a ray through a fixed point of the stop."""
        whole, height = self.paraxial.whole, self._entry_shift
        angle = self.paraxial.indices[0] * (self.vergence * height - 1.0)
        behind = (z - self.paraxial.length_mm) / self.paraxial.image_index
        return np.asarray(whole.a * height + whole.b * angle + behind * (whole.c * height + whole.d * angle))

    def trace(self, slope: Array, entry: Array) -> list[AimedRay]:
        """Return the rays that would cross the plane of the first vertex at `entry` (n, 2) if not refracted before."""
        angle = self.vergence * entry - slope
        start = np.column_stack([entry + self.start_z * angle, np.full(len(entry), self.start_z)])
        ahead = np.column_stack([angle, np.ones(len(entry))])
        moves = self.world.tables.frames
        to_world, to_camera = moves[CAMERA_FRAME, WORLD_FRAME], moves[WORLD_FRAME, CAMERA_FRAME]
        paths = trace(
            self.world, frames.points(to_world, start), frames.directions(to_world, ahead), self.wavelength_nm,
            split="transmit", record=True, weight_cutoff=0.0, threads=1,
        )  # fmt: skip
        rays: list[AimedRay | None] = [None] * len(entry)
        for packet, source in enumerate(paths.source):
            vertices = paths.vertices(packet)
            points = frames.points(to_camera, [vertex.position for vertex in vertices])
            names = [vertex.surface for vertex in vertices]
            status = Status(int(paths.status[packet]))
            face = np.array([self._faces.get(name, NO_FACE) for name in names])
            event = np.array([vertex.event for vertex in vertices])
            if not any(name in self._names for name in names):
                direction = frames.directions(to_camera, paths.direction[packet])
                points = self._ended_before_lens(points, direction, escaped=status == Status.ESCAPED)
                face, event = np.full(len(points), NO_FACE), np.zeros(len(points), np.int64)
            at_stop, leaving = self._at_stop(points, names), self._leaving(points, names)
            rays[source] = AimedRay(points, at_stop, leaving, status, face, event, points)
        nowhere = np.full(2, np.nan), np.full((2, 3), np.nan), Status.LOST, np.array([NO_FACE]), np.array([0])
        return [ray or AimedRay(p[None], *nowhere, p[None]) for ray, p in zip(rays, start, strict=True)]

    def _with_curves(self, rays: list[AimedRay]) -> list[AimedRay]:
        """Return rays with points along their curves in gradient-index glass."""
        if not has_gradients(self.world.scene) or not rays:
            return rays
        offsets = np.cumsum([0, *(len(ray.points) for ray in rays)])
        position, face, event = (
            np.concatenate(column) for column in zip(*((ray.points, ray.face, ray.event) for ray in rays), strict=True)
        )
        cell = np.full(len(face), -1)
        if self.world.tables.mla.gradient is not None:
            cell[face < NO_FACE] = cells_at(self.world.tables, position[face < NO_FACE])
        vertices = Vertices(position, face, cell, event, offsets, np.full(len(rays), self.wavelength_nm))
        segments = gradient_segments(self.world, vertices)
        curves = curves_of(self.world, vertices, segments)
        return [
            replace(ray, line=line_of(position, first, last - 1, curves))
            for ray, first, last in zip(rays, offsets.tolist(), offsets[1:].tolist(), strict=False)
        ]

    def _ended_before_lens(self, points: Array, direction: Array, *, escaped: bool) -> Array:
        """Return a path that misses the first surface, up to the plane of that surface's rim."""
        front = self.world.lens_shape.surfaces[0]
        z = float(front["vertex_z"]) + rim_range(front, self.world.lens_shape.rims[0])[1]
        before = points[points[:, 2] < z]
        if (len(before) == len(points) and not escaped) or not len(before):
            return points
        after = points[len(before)] - before[-1] if len(before) < len(points) else direction
        if not after[2] > 0.0:
            return before
        return np.vstack([before, before[-1] + (z - before[-1, 2]) / after[2] * after])

    def _at_stop(self, points: Array, names: list[str]) -> Array:
        """Return a path's crossing of the stop surface, or its end outside the aperture, in the stop's own frame."""
        points = frames.points(self._into_stop, points)
        passed = [i for i, name in enumerate(names) if name in self._names]
        k = self._before_stop
        before = [names[i] for i in passed[: k if self._pure_stop else k + 1]]
        if before != self._names[: len(before)]:
            # Total reflection or gradient-index glass turned it before the stop.
            return np.full(2, np.nan)
        if not self._pure_stop:
            if len(passed) > k:
                return points[passed[k], :2]
            if len(passed) < k or names[-1] != "stop":
                return np.full(2, np.nan)
            # Rays blocked by the stop end on the plane of the surface's rim.
            return _met(self.world.lens_shape.surfaces[k], points[-1], points[-1] - points[-2])[:2]
        if len(passed) < k:
            return np.full(2, np.nan)
        # The stop lies between lens surfaces, or before the first.
        first = passed[k - 1] if k else (passed[0] if passed else len(points) - 1) - 1
        z = self.lens.vertices_mm[self.paraxial.stop]
        if first == len(points) - 1 or not points[first, 2] <= z <= points[first + 1, 2] + 1e-9 * self.stop_radius:
            return np.full(2, np.nan)
        p, q = points[first], points[first + 1]
        return np.asarray(p[:2] + (z - p[2]) / (q[2] - p[2]) * (q[:2] - p[:2]))

    def _leaving(self, points: Array, names: list[str]) -> Array:
        last = next((i for i, name in enumerate(names) if name == self._names[-1]), len(names))
        if last >= len(points) - 1:
            return np.full((2, 3), np.nan)
        ahead = points[last + 1] - points[last]
        return np.stack([points[last], ahead / np.linalg.norm(ahead)])

    def _guess(self, slope: Array, aim: Array) -> Array:
        """Return estimated entry points (n, 2) on the plane of the first vertex; paraxial where aiming fails."""
        objects = self.world.tables.objects
        if not self.world.lens_shape.analytic.all() or objects.glass is not None or objects.fields is not None:
            # Glass, liquids and other media before the lens turn the rays, so they must be traced.
            return self._guess_by_fan(slope, aim)
        entry = (aim + self._stop_by_slope * slope) / self._stop_by_entry
        fields, which = np.unique(slope, axis=0, return_inverse=True)
        for number, field in enumerate(fields):
            mine = which.ravel() == number
            found = self._stop_aim.through(field, aim[mine], self.wavelength_nm).entry
            entry[mine] = np.where(np.isfinite(found), found, entry[mine])
        return entry

    def _guess_by_fan(self, slope: Array, aim: Array) -> Array:
        """Return the same from a fan of trial rays for every object point."""
        by_slope, scale = self._stop_by_slope, self._stop_by_entry
        entry = (aim + by_slope * slope) / scale
        fields, which = np.unique(slope, axis=0, return_inverse=True)
        middle = by_slope * fields / scale
        half = FAN_WIDTH * self.stop_radius / abs(scale)
        across = np.linspace(-half, half, FAN)
        trial = np.repeat(middle[:, None], FAN, axis=1)
        trial[:, :, 1] += across
        # Rays that miss the lens tell nothing.
        rim = self.world.lens_shape.rims[0]
        trial[:, :, 1] = np.clip(trial[:, :, 1], -rim, rim)
        rays = self.trace(np.repeat(fields, FAN, axis=0), trial.reshape(-1, 2))
        hits = np.array([ray.at_stop[1] for ray in rays]).reshape(len(fields), FAN)
        for i, field in enumerate(which.ravel()):
            known = np.isfinite(hits[field])
            y, order = np.unique(hits[field][known], return_index=True)
            if len(y) > 1:
                entry[i, 1] = _interpolated(aim[i, 1], y, trial[field, known, 1][order])
        return entry

    def _aimed(self, slope: Array, aim: Array, guess: Array) -> tuple[list[AimedRay], Array]:
        """Return the rays to stop points (n, 2), mm, and their entry points; rays that miss start as guessed."""

        def landing(entry: Array, which: NDArray[np.int64]) -> Array:
            return np.array([ray.at_stop for ray in self.trace(slope[which], entry)]).reshape(-1, 2)

        aimed = aim_rays(landing, aim, guess, DIFFERENCE * self.stop_radius, self.stop_radius)
        entry = np.where(aimed.arrived[:, None], aimed.start, guess)
        return self.trace(slope, entry), entry


def _met(surface: np.void, p: Array, ahead: Array) -> Array:
    """Return the point (3,) where a line through a nearby point meets a surface, by Newton's method; NaN if none."""
    ahead = ahead / np.linalg.norm(ahead)
    for _ in range(8):
        height = p[2] - surface["vertex_z"] - heights(surface, p[0], p[1])
        by_x, by_y = gradients(surface, p[0], p[1])
        p = p - height / (ahead[2] - by_x * ahead[0] - by_y * ahead[1]) * ahead
    return p


def _interpolated(x: float, known: Array, values: Array) -> float:
    """Return the value at x by linear interpolation, or extrapolation from the two outermost values."""
    k = int(np.clip(np.searchsorted(known, x), 1, len(known) - 1))
    share = (x - known[k - 1]) / (known[k] - known[k - 1])
    return float(values[k - 1] + share * (values[k] - values[k - 1]))
