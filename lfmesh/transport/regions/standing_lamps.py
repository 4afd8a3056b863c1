"""Lamps that stand on a surface, moved off it by more than the rounding of rays.

Light-emitting diodes stand on their board, panels on their wall. Rounding may put such a lamp on either side of the
surface, hidden from a random part of the scene. It is moved to the side that it lights or, if it lights both sides or
stands on glass, along the surface's normal.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import MissedLightWarning
from lfmesh.geometry.objects.targets import named_target
from lfmesh.scene import Scene
from lfmesh.scene.literals import counted, plain
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.regions.embree import Finder
from lfmesh.transport.regions.first_met import first_met
from lfmesh.transport.tables.lamp_tree import lamp_tree
from lfmesh.transport.tables.tables import OPAQUE, ObjectTables

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CLEAR = 2.0
"""Distance of a moved lamp from the surface, over the distance within which it stands on the surface."""

PROBE = 16.0
"""Distance from which probe rays start, in roundings of float32."""

MOST_SURFACES = 3
"""Largest number of surfaces to move a lamp off: those of a corner."""

STEEP = 0.5
"""Least cosine between a probe and the normal found; one of three axes has 1/√3 or more."""

GRAZING = 2.0**-10
"""Least excess of the sine of a lamp's reach over the cosine of its axis with which it lights its surface."""

POINTS = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
"""Points of a lamp that may stand on a surface, in its half axes."""


STANDING = np.dtype(
    [
        ("facet", "i8"),  # facet under a lamp; −1: none
        ("normal", "f8", (3,)),  # unit normal of the facet
        ("height", "f8"),  # mm, height of the lamp over it
        ("grain", "f8"),  # mm, largest height of a standing lamp
    ]
)
"""Surface on which a lamp stands."""


def off_surfaces(
    scene: Scene, objects: ObjectTables, finder: Finder
) -> tuple[ObjectTables, tuple[MissedLightWarning, ...]]:  # fmt: skip
    """Return tables with lamps moved clear of all surfaces, and warnings about lamps that shine onto their own target.

    Parameters
    ----------
    scene : Scene
    objects : ObjectTables
    finder : Finder
        Finder of object space.
    """
    lamps = objects.lamps
    if not lamps.rows["placed"].any() or not len(objects.facets):
        return objects, ()
    rows = lamps.rows.copy()
    shining: list[tuple[int, int, float]] = []
    for _ in range(MOST_SURFACES):
        standing = _standing(objects, finder, rows)
        lamp = np.flatnonzero(standing["facet"] >= 0)
        if not len(lamp):
            break
        found, own = standing[lamp], rows[lamp]
        body = objects.facets["body"][found["facet"]]
        on_glass = (body >= 0) & (np.append(objects.medium, OPAQUE)[body] != OPAQUE)
        along = np.einsum("ij,ij->i", found["normal"], own["direction"])
        to_back = (own["outer"] <= 1.0) & (along < 0.0) & ~on_glass
        off = CLEAR * found["grain"]
        rows["position"][lamp] += (np.where(to_back, -off, off) - found["height"])[:, None] * found["normal"]
        # Sine of the lamp's largest emission angle.
        sine = np.where(own["outer"] < 1.0, np.sqrt(own["outer"] * np.maximum(2.0 - own["outer"], 0.0)), 1.0)
        onto = (body >= 0) & ~on_glass & ((own["outer"] > 1.0) | (np.abs(along) < sine - GRAZING))
        shining += zip(lamp[onto].tolist(), body[onto].tolist(), off[onto].tolist(), strict=True)
    if (rows["position"] == lamps.rows["position"]).all():
        return objects, ()
    nodes, power, leaf = lamp_tree(rows, rows["power"][:, None] * lamps.spectra)
    moved = lamps._replace(rows=rows, nodes=nodes, power=power, leaf=leaf)
    return objects._replace(lamps=moved), tuple(_named(scene, shining))


def _named(scene: Scene, shining: list[tuple[int, int, float]]) -> Iterator[MissedLightWarning]:
    """Warn of the first lamp that shines onto the target under it, with its distance off the target, mm."""
    if shining:
        lamp, target, off = shining[0]
        others = len({number for number, _, _ in shining}) - 1
        more = f" (likewise {counted(others, 'more light')})" if others else ""
        yield MissedLightWarning(
            f"lights[{lamp}] stands on {named_target(scene, target)} and shines onto it{more}. It is traced "
            f"{plain(off, 2)} mm off the surface, and light of the spot below it may be missing. Move it some tenths "
            "of a millimetre off the surface, or use a lamp that shines away from it"
        )


def _standing(objects: ObjectTables, finder: Finder, rows: NDArray[np.void]) -> NDArray[np.void]:
    """Return the surface under each lamp, (lamps,) STANDING."""
    standing = np.zeros(len(rows), STANDING)
    standing["facet"] = -1
    arms = rows["half"][:, :, None] * rows["across"]
    for a, b in POINTS:
        if (a, b) != POINTS[0] and not (rows["size"] > 0.0).any():
            break
        places = rows["position"] + a * arms[:, 0] + b * arms[:, 1]
        coordinates = np.abs(places).sum(axis=1)
        back = PROBE * FLOAT32_GRAIN * (coordinates + objects.radius)
        for probe in np.eye(3):
            starts = places - back[:, None] * probe
            facet, t, normal = first_met(objects, finder, starts, np.tile(probe, (len(rows), 1)))
            along = normal @ probe
            height = (back - np.where(facet >= 0, t, 0.0)) * along
            grain = FLOAT32_GRAIN * (coordinates + _sizes(objects, facet))
            # An extended lamp must lie in the surface.
            tilt = np.abs(np.einsum("ijk,ik->ij", arms, normal)).sum(axis=1)
            found = rows["placed"] & (standing["facet"] < 0) & (facet >= 0) & (np.abs(along) >= STEEP)
            found &= (np.abs(height) <= grain) & (tilt <= grain)
            for name, values in (("facet", facet), ("normal", normal), ("height", height), ("grain", grain)):
                standing[name][found] = values[found]
    return standing


def _sizes(objects: ObjectTables, facet: Index) -> Array:
    """Return the sizes of facets, mm, (n,), or the radii of round faces; arbitrary for no facet, −1."""
    sizes = objects.facets["size"][np.maximum(facet, 0)]
    if objects.rounds is not None:
        faces = objects.rounds.faces
        number = facet - objects.rounds.first
        sizes = np.where(number >= 0, faces["radius"][np.clip(number, 0, len(faces) - 1)], sizes)
    return np.asarray(sizes)
