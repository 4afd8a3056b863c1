"""Media of a scene as drawings show them: their bodies, their amounts in words and over space, their colours."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lfmesh.geometry import frame
from lfmesh.geometry.index_media import bends
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.objects.primitives import primitive
from lfmesh.scene.light.spectra import Spectrum, spectral_in_words
from lfmesh.scene.media.media import Medium
from lfmesh.scene.objects.shapes import Box, Cylinder, Sphere
from lfmesh.transport.packets.packet import OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.tables.volumes import (
    BY_TEMPERATURE,
    COLDEST_K,
    CYLINDER,
    NOT_IN_GRID,
    SHELL,
    SPHERE,
    corners_of,
)
from lfmesh.transport.world import World

EMITS, SCATTERS, ABSORBS = "emits", "scatters", "absorbs"

COLOURS = {EMITS: "#f0a030", SCATTERS: "#8fb0c8", ABSORBS: "#9a7b55"}
"""Colours of media by their first effect in this order."""

MOST_CELLS = 96
"""Most cells of a drawn medium along each axis."""


class Amount(NamedTuple):
    """Amount of an effect over its largest, on a lattice.

    Attributes
    ----------
    values : (nx, ny, nz) float64
        0 to 1.
    origin_mm, spacing_mm : (3,) float64
        Centre of voxel [0, 0, 0], and distances between centres, in the medium's own frame.
    """

    values: Array
    origin_mm: Array
    spacing_mm: Array


@dataclass(frozen=True)
class ShownMedium:
    """A medium as drawings show it.

    Attributes
    ----------
    name : str
    amounts : str
        Emission, scattering and absorption in words, at the primary wavelength.
    effect : str
        `EMITS`, `SCATTERS` or `ABSORBS`; "" if it has no effect at that wavelength.
    body : Mesh or None
        Boundary, mm, world frame. None if it fills a body of glass or liquid, or all space before the camera.
    fills : str
        The body of glass or liquid that it fills; "" for all space.
    grid : Amount or None
        None if it is uniform.
    to_world : (3, 4) float64
        From the medium's own frame.
    depth : float
        Optical depth through the longest edge of its box; per mm if it is unbounded.
    """

    name: str
    amounts: str
    effect: str
    body: Mesh | None
    fills: str
    grid: Amount | None
    to_world: Array
    depth: float

    @property
    def colour(self) -> str:
        """Colour, #rrggbb."""
        return COLOURS.get(self.effect, COLOURS[ABSORBS])

    @property
    def in_words(self) -> str:
        """Name, place if it has no body, and amounts."""
        if self.body is not None:
            return f"{self.name} {self.amounts}"
        return f"{self.name}, {f'in {self.fills}' if self.fills else 'everywhere before the camera'}, {self.amounts}"


def shown_media(world: World) -> list[ShownMedium]:
    """Return the media of a built scene."""
    return [shown_medium(world, number) for number in range(len(world.scene.media))]


def media_bodies(world: World) -> list[Mesh]:
    """Return the boundaries of media that have one of their own, mm, world frame."""
    bodies = (_body(world, number) for number in range(len(world.scene.media)))
    return [body for body in bodies if body is not None]


def shown_medium(world: World, number: int) -> ShownMedium:
    """Return a medium of a built scene, by its number."""
    medium = world.scene.media[number]
    amounts = _amounts(world, number, medium)
    words = [*amounts.values(), *(["bends light"] if bends(world.scene, medium) else [])]
    effect = next(iter(amounts), "")
    body = _body(world, number)
    return ShownMedium(
        medium.name or f"media[{number}]",
        ", ".join(words) or f"has no effect at {world.scene.primary_nm:g} nm",
        effect,
        body,
        medium.inside or "",
        _grid(world, number, effect) if body is not None else None,
        _to_world(world, number),
        _depth(world, number),
    )


def _to_world(world: World, number: int) -> Array:
    """Return the (3, 4) motion from a medium's own frame to the world."""
    to_own = world.tables.objects.volumes.rows[number]["to_own"]
    return frame.compose(world.tables.frames[OBJECT_FRAME, WORLD_FRAME], frame.inverse(to_own))


def _body(world: World, number: int) -> Mesh | None:
    """Return the boundary of a medium, mm, world frame; None if it has none of its own."""
    facets = _facets(world, number)
    if facets is None:
        return None
    vertices = frame.points(_to_world(world, number), facets.reshape(-1, 3))
    return Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3))


def _colour_number(world: World) -> int:
    """Return the number of the traced wavelength nearest the primary one."""
    return int(np.argmin(np.abs(np.array(world.lines.wavelengths_nm) - world.scene.primary_nm)))


def _voxels(world: World, number: int, quantity: str) -> Array | None:
    """Return a quantity of a medium's grid, (nx, ny, nz); None if the grid does not hold it."""
    volumes = world.tables.objects.volumes
    row = volumes.rows[number]
    if row[quantity] == NOT_IN_GRID:
        return None
    shape = tuple(int(cells) for cells in row["cells"])
    first = int(row[quantity])
    return np.asarray(volumes.values[first : first + int(np.prod(shape))].reshape(shape))


def _amounts(world: World, number: int, medium: Medium) -> dict[str, str]:
    """Return the effects of a medium in words, by effect."""
    volumes, colour = world.tables.objects.volumes, _colour_number(world)
    found = {EMITS: _emission(world, number, medium)}
    for effect, quantity in ((SCATTERS, "scattering"), (ABSORBS, "absorption")):
        voxels = _voxels(world, number, quantity)
        value = getattr(volumes, quantity)[number, colour] * (1.0 if voxels is None else voxels.max(initial=0.0))
        upto = "" if voxels is None else "up to "
        found[effect] = f"{effect} {upto}{value:.3g} per mm" if value > 0.0 else ""
    return {effect: words for effect, words in found.items() if words}


def _emission(world: World, number: int, medium: Medium) -> str:
    """Return the emission of a medium in words, "" if it has none."""
    voxels = _voxels(world, number, "emission")
    if voxels is not None:
        most = float(voxels.max(initial=0.0))
        if world.tables.objects.volumes.rows[number]["emits"] == BY_TEMPERATURE:
            return f"glows at up to {most:.4g} K" if most > 0.0 else ""
        return f"emits up to {most:.3g} W/(mm³ sr)" if most > 0.0 else ""
    if medium.temperature_k is not None:
        # That of air that absorbs nothing sets its index alone.
        emits = bool(world.tables.objects.volumes.emission[number].any())
        return f"glows at {medium.temperature_k:g} K" if emits else ""
    emission = medium.emission_w_mm3_sr
    if isinstance(emission, Spectrum):
        return f"emits {spectral_in_words(emission)}, in W/(mm³ sr nm)"
    return f"emits {emission:.3g} W/(mm³ sr)" if emission > 0.0 else ""


def _grid(world: World, number: int, effect: str) -> Amount | None:
    """Return the amount of an effect, on a coarse lattice if its own is fine; None if it is uniform."""
    amount = _amount(world, number, effect)
    largest = 0.0 if amount is None else float(amount.max(initial=0.0))
    if amount is None or not largest > 0.0:
        return None
    row = world.tables.objects.volumes.rows[number]
    step = np.array([-(-cells // MOST_CELLS) for cells in amount.shape])
    for axis in range(3):
        # The largest of merged voxels, so that thin flames remain.
        amount = np.maximum.reduceat(amount, np.arange(0, amount.shape[axis], step[axis]), axis=axis)
    origin = row["origin"] + 0.5 * (step - 1) * row["spacing"]
    return Amount(amount / largest, origin, step * row["spacing"])


def _amount(world: World, number: int, effect: str) -> Array | None:
    """Return the amount of an effect in each voxel, in any unit; None if it is uniform."""
    volumes = world.tables.objects.volumes
    row = volumes.rows[number]
    absorption = _voxels(world, number, "absorption")
    amount = absorption if effect == ABSORBS else _voxels(world, number, "scattering") if effect == SCATTERS else None
    if effect == EMITS:
        amount = _voxels(world, number, "emission")
        if amount is None:
            # Given for the whole medium: a body of one temperature emits where it absorbs.
            amount = absorption if world.scene.media[number].temperature_k is not None else None
        elif row["emits"] == BY_TEMPERATURE:
            with np.errstate(over="ignore"):
                amount = 1.0 / np.expm1(volumes.planck[1, _colour_number(world)] / np.maximum(amount, COLDEST_K))
            amount = amount if absorption is None else amount * absorption
    return amount


def _facets(world: World, number: int) -> Array | None:
    """Return the facets of a medium's boundary, (m, 3, 3) mm, in its own frame; None if it has none of its own."""
    medium, volumes = world.scene.media[number], world.tables.objects.volumes
    row = volumes.rows[number]
    corners = corners_of(row)
    if corners is None or (medium.bounds is None and medium.grid is None):
        return None
    if row["cells"][0] == 0 and row["bounds"] == SHELL:
        leaves = volumes.shells.nodes[slice(*row["nodes"])]
        leaves = leaves[leaves["count"] > 0]
        return np.asarray(volumes.shells.corners[leaves["first"][0] : leaves["first"][-1] + leaves["count"][-1]])
    radius, half = float(row["size"][0]), float(row["size"][2])
    shape: Box | Sphere | Cylinder = Box(size_mm=tuple((corners[-1] - corners[0]).tolist()))
    if row["cells"][0] == 0 and row["bounds"] == SPHERE:
        shape = Sphere(radius_mm=radius)
    elif row["cells"][0] == 0 and row["bounds"] == CYLINDER:
        shape = Cylinder(radius_mm=radius, height_mm=2.0 * half)
    mesh = primitive(shape).mesh
    return np.asarray(mesh.vertices[mesh.faces] + 0.5 * (corners[0] + corners[-1]))


def _depth(world: World, number: int) -> float:
    """Return the mean extinction of a medium times the longest edge of its box, or alone if it is unbounded."""
    volumes, colour = world.tables.objects.volumes, _colour_number(world)
    extinction = 0.0
    for quantity in ("absorption", "scattering"):
        voxels = _voxels(world, number, quantity)
        mean = 1.0 if voxels is None else float(voxels.mean())
        extinction += float(getattr(volumes, quantity)[number, colour]) * mean
    corners = corners_of(volumes.rows[number])
    return extinction if corners is None else extinction * float((corners[-1] - corners[0]).max())
