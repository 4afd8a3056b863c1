"""Particles: points that shine or that a light sheet lights, from a file or random, moved between frames."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lfmesh.errors import FileError
from lfmesh.optics.number_table import read_table
from lfmesh.scene.light.spectra import Resolves
from lfmesh.scene.light.spectra import Shape as SpectralShape
from lfmesh.scene.light.turns import rotation, turned_about
from lfmesh.scene.media.phase import IsotropicPhase, Phase
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.objects.shapes import Box, Cylinder, Sphere
from lfmesh.scene.quantities import Count, FilePath, NonNegative, Number, Positive, Text, Vector, Whole, no_direction

Array = NDArray[np.float64]

MOST_PARTICLES = 20_000_000

DARKEST = 1e-6
"""Brightness in a sheet, relative to the brightest particle, below which particles are left out."""

ACROSS = 1e-3
"""Largest sine of the angle between a sheet's light and its plane."""

PLACE = ("x_mm", "y_mm", "z_mm")
INTENSITY = "intensity_w_sr"
VECTOR = ("dx_mm", "dy_mm", "dz_mm")

Bounds = Annotated[Box | Sphere | Cylinder, Field(discriminator="kind")]


class Sheet(Model):
    """A light sheet: parallel light, Gaussian across the sheet and even along it."""

    point_mm: Vector
    """Centre of the sheet, in its middle plane and halfway across its width, in mm."""
    normal: Vector
    """Normal of the sheet; of any length from 1e-100 to 1e100."""
    direction: Vector
    """Direction of the light in the sheet; of any length from 1e-100 to 1e100."""
    thickness_mm: Positive
    """Full thickness of the sheet, in mm, between the surfaces where the irradiance is 1/e² of its peak."""
    width_mm: Positive
    """Extent of the sheet perpendicular to `normal` and `direction`, in mm; there is no light beyond it."""
    power_w: Positive
    """Power of the sheet, in W. It applies at each wavelength of `transport.wavelengths_nm`, or with bands to the whole
    range from the start of the first band to the end of the last."""

    def faults(self) -> Iterator[Fault]:
        """Yield vectors that give no direction, or are not perpendicular."""
        for key in ("normal", "direction"):
            if why := no_direction(getattr(self, key)):
                yield Fault((key,), list(getattr(self, key)), why)
        if not (no_direction(self.normal) or no_direction(self.direction)):
            n, d = unit(self.normal), unit(self.direction)
            if abs(float(n @ d)) > ACROSS:
                yield Fault(("direction",), list(self.direction), "must lie in the sheet, perpendicular to normal")

    def irradiance_w_mm2(self, points_mm: Array) -> Array:
        """Return the irradiance on a plane perpendicular to the light.

        Parameters
        ----------
        points_mm : (n, 3) float64, mm
            World frame.

        Returns
        -------
        (n,) float64
            W/mm².
        """
        n, d = unit(self.normal), unit(self.direction)
        off = points_mm - np.array(self.point_mm)
        radius = 0.5 * self.thickness_mm
        # ∫ exp(−2 s² / w²) ds = w √(π/2).
        peak = self.power_w / (self.width_mm * radius * np.sqrt(0.5 * np.pi))
        inside = np.abs(off @ np.cross(n, d)) <= 0.5 * self.width_mm
        return np.asarray(np.where(inside, peak * np.exp(-2.0 * (off @ n / radius) ** 2), 0.0))


class UniformDisplacement(Model):
    """All particles move by the same vector."""

    kind: Literal["uniform"] = "uniform"
    """Kind of displacement field."""
    vector_mm: Vector
    """Displacement from one frame to the next, in mm."""


class _AboutAxis(Model):
    center_mm: Vector
    """A point on the axis, in mm."""
    axis: Vector
    """Direction of the axis; of any length from 1e-100 to 1e100."""

    def faults(self) -> Iterator[Fault]:
        """Yield an axis that gives no direction."""
        if why := no_direction(self.axis):
            yield Fault(("axis",), list(self.axis), why)


class RotationDisplacement(_AboutAxis):
    """All particles rotate about an axis."""

    kind: Literal["rotation"] = "rotation"
    """Kind of displacement field."""
    angle_deg: Number
    """Angle from one frame to the next, in degrees, counter-clockwise with the axis pointing at the viewer."""


class VortexDisplacement(_AboutAxis):
    """A Lamb-Oseen vortex: particles circle an axis, fastest near the core's radius."""

    kind: Literal["vortex"] = "vortex"
    """Kind of displacement field."""
    core_mm: Positive
    """Radius of the core, in mm: the displacement along the circle is Γ (1 − exp(−r² / core²)) / (2 π r)."""
    circulation_mm2: Number
    """Γ, in mm² from one frame to the next; positive is a right-handed turn about the axis."""


class MeasuredDisplacement(Model):
    """Displacements from a file, interpolated linearly between the nodes of a grid."""

    kind: Literal["file"] = "file"
    """Kind of displacement field."""
    file: FilePath
    """CSV file, relative to the scene file, with x_mm, y_mm, z_mm, dx_mm, dy_mm and dz_mm on the nodes of a grid. The
    grid is aligned with x, y, z; its nodes may be in any order. Particles outside it do not move."""


Displacement = Annotated[
    UniformDisplacement | RotationDisplacement | VortexDisplacement | MeasuredDisplacement, Field(discriminator="kind")
]


class Particles(Model):
    """Points that shine evenly in all directions, or scatter the light of a light sheet."""

    name: Text | None = None
    """Name of the particles in messages."""
    file: FilePath | None = None
    """CSV file, relative to the scene file, with x_mm, y_mm, z_mm and intensity_w_sr. Leave the last column out with
    `sheet` or `intensity_w_sr`. Or give `count` and `bounds`."""
    count: Annotated[Count, Field(le=MOST_PARTICLES)] | None = None
    """Number of particles drawn uniformly in `bounds`."""
    bounds: Bounds | None = None
    """Body filled with particles: box, sphere or cylinder."""
    seed: Whole = 0
    """Random seed of the positions (no unit)."""
    position_mm: Vector = (0.0, 0.0, 0.0)
    """Position of the centre of `bounds`, or of the origin of the file's coordinates, in mm."""
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    """Rotations of `bounds`, or of the file's positions, about x, then y, then z, in degrees."""
    intensity_w_sr: NonNegative | None = None
    """Radiant intensity of each particle, in W/sr, the same in all directions. It applies at each wavelength of
    `transport.wavelengths_nm`, or with bands to the whole range from the start of the first band to the end of the
    last. Omitted: that of the file or by `sheet`."""
    spectrum: SpectralShape | None = None
    """Spectrum of their power, or of the sheet's, in any unit; as for lights. Needs bands. Omitted: the same at all
    wavelengths."""
    sheet: Sheet | None = None
    """Light sheet that illuminates them, in place of an intensity of their own."""
    phase: Phase = Field(default_factory=IsotropicPhase)
    """Phase function of the light scattered from the sheet."""
    diameter_um: Positive | None = None
    """Diameter, in µm; a particle scatters all the light that falls on its cross-section. With `kind = "mie"` the
    diameter belongs in `phase`, and the scattering cross-section follows from it."""
    displacement: Displacement | None = None
    """Displacement from one frame to the next, for image pairs."""
    frame_time_s: Positive | None = None
    """Time from one frame to the next, in s: during the exposure each particle moves along its displacement and leaves
    a streak. Needs `displacement` and `[exposure]`. Omitted: particles stand still during the exposure."""
    frame: Annotated[int, Field(strict=True, ge=0, le=100_000)] = 0
    """Number of displacements so far (no unit)."""
    samples: Count = 64
    """Packets from each particle to the lens per wavelength, in all replicates; at least one per replicate."""

    def faults(self) -> Iterator[Fault]:
        """Yield keys that are missing or given twice."""
        if self.file is not None:
            for key in ("count", "bounds"):
                if getattr(self, key) is not None:
                    yield Fault((key,), None, "file is given too: positions are either read or drawn")
        else:
            for key in ("count", "bounds"):
                if getattr(self, key) is None:
                    yield Fault((key,), None, "missing: give file, or count and bounds")
        if self.sheet is None:
            if self.file is None and self.intensity_w_sr is None:
                yield Fault(("intensity_w_sr",), None, "missing: give it, or a light sheet")
            if self.phase != IsotropicPhase():
                yield Fault(("phase",), self.phase.kind, "scatters light of a sheet, but none is given; omit it")
            if self.diameter_um is not None:
                yield Fault(("diameter_um",), self.diameter_um, "scatters light of a sheet, but none is given; omit it")
        else:
            if self.intensity_w_sr is not None:
                yield Fault(("intensity_w_sr",), self.intensity_w_sr, "a sheet lights them: give one of the two")
            if self.phase.gives_size and self.diameter_um is not None:
                yield Fault(("diameter_um",), self.diameter_um, "belongs in phase, whose kind is mie; omit it here")
            elif not self.phase.gives_size and self.diameter_um is None:
                yield Fault(("diameter_um",), None, "missing: particles in a sheet need it, or phase of kind mie")
        if self.frame_time_s is not None and self.displacement is None:
            yield Fault(("frame_time_s",), self.frame_time_s, "needs displacement, the way in that time")
        if self.frame and self.displacement is None:
            yield Fault(("frame",), self.frame, "needs displacement")


def unit(vector: Any) -> Array:
    """Return the unit vector along a vector, (3,), however short or long that is."""
    v = np.array(vector, dtype=np.float64)
    v /= np.abs(v).max()
    return np.asarray(v / np.linalg.norm(v))


def particle_places(group: Particles, scene: Resolves) -> tuple[Array, Array]:
    """Return the positions of particles in the world frame, and their intensities.

    Parameters
    ----------
    group : Particles
    scene : Resolves

    Returns
    -------
    points : (n, 3) float64, mm
    intensity : (n,) float64, W/sr
        Irradiance, W/mm², with a light sheet.

    Raises
    ------
    FileError
        A file cannot be used.
    """
    own = None
    if group.file is not None:
        path = scene.resolve(group.file)
        needs_own = group.sheet is None and group.intensity_w_sr is None
        columns = read_table(path, (*PLACE, INTENSITY) if needs_own else PLACE)
        if not len(columns[0]):
            raise FileError(f"{path}: has no particles below its first line")
        if len(columns[0]) > MOST_PARTICLES:
            raise FileError(f"{path}: has {len(columns[0]):,} particles; at most {MOST_PARTICLES:,} are allowed")
        for name, column in zip((*PLACE, INTENSITY), columns, strict=False):
            wrong = np.flatnonzero(~np.isfinite(column) | ((column < 0.0) if name == INTENSITY else False))
            if len(wrong):
                rule = "a finite number, 0 or more" if name == INTENSITY else "a finite number"
                raise FileError(f"{path}: {name} of particle {wrong[0] + 1} is {column[wrong[0]]:g}; it must be {rule}")
        points = np.stack(columns[:3], axis=1)
        own = columns[3] if needs_own else None
    else:
        points = _drawn(group)
    points = points @ rotation(group.rotation_deg).T + np.array(group.position_mm)
    points = displaced_places(group, points, scene)
    if group.sheet is not None:
        return points, group.sheet.irradiance_w_mm2(points)
    return points, own if own is not None else np.full(len(points), group.intensity_w_sr or 0.0)


def shining_particles(group: Particles, scene: Resolves) -> tuple[Array, Array]:
    """Return the particles of a group that shine, in the form of `particle_places`.

    Parameters
    ----------
    group : Particles
    scene : Resolves
    """
    points, strength = particle_places(group, scene)
    bright = strength > (DARKEST * strength.max() if group.sheet is not None else 0.0)
    return points[bright], strength[bright]


def _drawn(group: Particles) -> Array:
    """Draw positions uniformly in the bounds, (n, 3), mm, in the frame of the bounds."""
    u = np.random.default_rng(group.seed).random((group.count or 0, 3))
    match group.bounds:
        case Box(size_mm=size):
            return (u - 0.5) * np.array(size)
        case Sphere(radius_mm=radius):
            r, cosine, phi = radius * np.cbrt(u[:, 0]), 2.0 * u[:, 1] - 1.0, 2.0 * np.pi * u[:, 2]
            across = r * np.sqrt(1.0 - cosine**2)
            return np.stack([across * np.cos(phi), across * np.sin(phi), r * cosine], axis=1)
        case Cylinder(radius_mm=radius, height_mm=height):
            r, phi = radius * np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
            return np.stack([r * np.cos(phi), r * np.sin(phi), height * (u[:, 2] - 0.5)], axis=1)
    raise AssertionError("particles without places")


def displaced_places(group: Particles, points: Array, scene: Resolves) -> Array:
    """Return the positions of particles after all displacements up to their frame.

    Parameters
    ----------
    group : Particles
    points : (n, 3) float64, mm
        World frame, in the first frame.
    scene : Resolves
    """
    for _ in range(group.frame):
        points = points + displacements(group, points, scene)
    return points


def particle_velocities(group: Particles, points: Array, scene: Resolves) -> Array | None:
    """Return the velocities of particles during the exposure, (n, 3) float64, mm/s; None at rest.

    Parameters
    ----------
    group : Particles
    points : (n, 3) float64, mm
        World frame, in the present frame, at t = 0.
    scene : Resolves

    Raises
    ------
    FileError
        The file of a displacement field cannot be used.
    """
    return None if group.frame_time_s is None else displacements(group, points, scene) / group.frame_time_s


def displacements(group: Particles, points: Array, scene: Resolves) -> Array:
    """Return the displacements of particles to the next frame.

    Parameters
    ----------
    group : Particles
    points : (n, 3) float64, mm, world frame
    scene : Resolves

    Returns
    -------
    (n, 3) float64, mm

    Raises
    ------
    FileError
        The file of a displacement field cannot be used.
    """
    match group.displacement:
        case UniformDisplacement(vector_mm=vector):
            return np.tile(np.array(vector), (len(points), 1))
        case RotationDisplacement(center_mm=center, axis=axis, angle_deg=angle):
            off = points - np.array(center)
            return off @ (turned_about(unit(axis), np.deg2rad(angle)) - np.eye(3)).T
        case VortexDisplacement(center_mm=center, axis=axis, core_mm=core, circulation_mm2=circulation):
            along = unit(axis)
            off = points - np.array(center)
            off -= (off @ along)[:, None] * along
            radius = np.linalg.norm(off, axis=1)
            # Γ (1 − exp(−r² / c²)) / (2 π r) along the circle, over the radius: its limit on the axis is Γ / (2 π c²).
            square = (radius / core) ** 2
            share = np.divide(-np.expm1(-square), square, out=np.ones_like(square), where=square > 0.0)
            angle = circulation / (2.0 * np.pi * core**2) * share
            # Along the circle itself: a step along the tangent would leave it.
            turned = np.cross(along, off)
            return np.sin(angle)[:, None] * turned - 2.0 * (np.sin(0.5 * angle) ** 2)[:, None] * off
        case MeasuredDisplacement(file=file):
            return _from_grid(scene, file, points)
    return np.zeros_like(points)


def _from_grid(scene: Resolves, file: str, points: Array) -> Array:
    """Return the displacements of a file at points, interpolated linearly and 0 outside its grid."""
    path = scene.resolve(file)
    columns = read_table(path, (*PLACE, *VECTOR))
    for name, column in zip((*PLACE, *VECTOR), columns, strict=True):
        if not np.isfinite(column).all():
            raise FileError(f"{path}: {name} must be finite numbers")
    axes = [np.unique(column) for column in columns[:3]]
    size = [len(axis) for axis in axes]
    if min(size, default=0) < 2:
        raise FileError(f"{path}: its grid must have at least two points along each of x, y and z")
    place = [np.searchsorted(axis, column) for axis, column in zip(axes, columns[:3], strict=True)]
    number = np.ravel_multi_index((place[0], place[1], place[2]), (size[0], size[1], size[2]))
    if len(number) != np.prod(size) or len(np.unique(number)) != len(number):
        raise FileError(
            f"{path}: {len(number)} points do not form a grid; {size[0]} x {size[1]} x {size[2]} values of x, y and z "
            "need one point for each combination"
        )
    vectors = np.empty((len(number), 3))
    vectors[number] = np.stack(columns[3:], axis=1)
    vectors = vectors.reshape(*size, 3)
    found = np.zeros_like(points)
    inside = np.ones(len(points), dtype=np.bool_)
    cells, shares = [], []
    for axis, column in zip(axes, points.T, strict=True):
        inside &= (column >= axis[0]) & (column <= axis[-1])
        cell = np.clip(np.searchsorted(axis, column, side="right") - 1, 0, len(axis) - 2)
        cells.append(cell)
        shares.append((column - axis[cell]) / np.diff(axis)[cell])
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod([t if k else 1.0 - t for k, t in zip(corner, shares, strict=True)], axis=0)
        i, j, k = (cell + step for cell, step in zip(cells, corner, strict=True))
        found += np.where(inside, weight, 0.0)[:, None] * vectors[i, j, k]
    return found
