"""Bodies of glass and liquid in object space as places: the points that they hold, and their properties."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.crossings import parts_in_shells, set_back
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.kernels.by_address import by_address
from lfmesh.scene import Scene
from lfmesh.transport.tables.contacts import CUT
from lfmesh.transport.tables.tables import AIR, OPAQUE, Media

Numbers = NDArray[np.int64]


@by_address
class Hosts(NamedTuple):
    """Bodies of glass or liquid among the targets of a scene; other targets have rank 0."""

    names: list[str]  # as users name them
    rank: Numbers  # (targets,) see `ObjectTables.rank`
    medium: Numbers  # (targets,) number of the medium; OPAQUE for other targets
    media: Media
    corners: list[Array]  # (m, 3, 3) mm, world frame, of the facets of each body; empty for other targets
    boxes: list[Array]  # (2, 3) mm, world frame, lowest and highest corner of each target

    def box_mm(self, body: int) -> tuple[Array, Array]:
        """Return the lowest and the highest corner of a body, world frame."""
        low, high = self.boxes[body]
        return low, high

    def index_of(self, body: int | None) -> Array:
        """Return the refractive index at each wavelength of a body, or of the medium round all bodies for None."""
        return self.media.indices[AIR if body is None else self.medium[body]]

    def absorbing(self, bodies: set[int]) -> list[int]:
        """Return all bodies filled with the same absorbing media as some bodies."""
        absorption = self.media.absorption
        numbers = {int(self.medium[body]) for body in bodies}
        return [
            body
            for body, number in enumerate(self.medium.tolist())
            if number in numbers and (absorption.per_mm[number] > 0.0).any()
        ]

    def absorption_of(self, body: int) -> tuple[Array, int]:
        """Return an absorbing body's absorption coefficient at each wavelength, 1/mm, and its slot of the book."""
        number = self.medium[body]
        return self.media.absorption.per_mm[number], int(self.media.absorption.slot[number])

    def without_absorption(self, bodies: list[int]) -> Media:
        """Return the media, with the media of some bodies made clear."""
        if not bodies:
            return self.media
        per_mm = self.media.absorption.per_mm.copy()
        per_mm[self.medium[bodies]] = 0.0
        return self.media._replace(absorption=self.media.absorption._replace(per_mm=per_mm))

    def number_of(self, body: int | None) -> int:
        """Return the number of the medium of a body, or of the medium round all bodies for None."""
        return AIR if body is None else int(self.medium[body])

    def near(self, surface: Array) -> list[int]:
        """Return the bodies with boxes that meet the box of a surface, given by the corners (n, 3, 3) of its facets."""
        low, high = surface.min(axis=(0, 1)), surface.max(axis=(0, 1))
        boxes = [(body, *self.box_mm(body)) for body in np.flatnonzero(self.rank).tolist()]
        return [body for body, lowest, highest in boxes if (lowest <= high).all() and (highest >= low).all()]

    def touching_mm(self, surface: Array, bodies: list[int]) -> float:
        """Return the distance within which a surface touches some bodies, mm."""
        parts = [surface, *(self.corners[body] for body in bodies)]
        return CUT * min(float(np.ptp(corners, axis=(0, 1)).max()) for corners in parts)

    def along(self, target: TargetMesh) -> list[int | None]:
        """Return the bodies that contain parts of a target's surface, as `top_along` does."""
        if not self.rank.any():
            return [None]
        return self.top_along(target.mesh.vertices[target.mesh.faces])

    def top_along(self, surface: Array, *, just_inside: bool = False) -> list[int | None]:
        """Return the bodies that contain parts of a surface, only the one of highest rank at each place.

        None represents the medium round all bodies. Parts in contact with faces of bodies are left out.

        Parameters
        ----------
        surface : (n, 3, 3) float64, mm, world frame
            Corners of its facets.
        just_inside : bool
            Test the places just behind the surface instead.
        """
        bodies = self.near(surface)
        if not bodies:
            return [None]
        touching = self.touching_mm(surface, bodies)
        own = set_back(surface, touching) if just_inside else surface
        parts, _ = parts_in_shells(own, [self.corners[body] for body in bodies], touching)
        tops = {
            max((body for body, holds in zip(bodies, row, strict=True) if holds), key=self._rank_of, default=None)
            for row in parts.tolist()
        }
        return sorted(tops, key=self._rank_of) or [None]

    def _rank_of(self, body: int | None) -> int:
        return 0 if body is None else int(self.rank[body])


def hosts_of(scene: Scene, targets: list[TargetMesh], ranks: Numbers, medium: Numbers, media: Media) -> Hosts:
    """Return the bodies of a scene.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        World frame.
    ranks, medium : (targets,) int64
        See `ObjectTables`.
    media : Media
    """
    names = [target.name or f"targets[{i}]" for i, target in enumerate(scene.targets)]
    bodies = np.where(medium == OPAQUE, 0, ranks)
    corners = [
        target.mesh.vertices[target.mesh.faces] if rank else np.zeros((0, 3, 3))
        for target, rank in zip(targets, bodies, strict=True)
    ]
    return Hosts(names, bodies, medium, media, corners, [target.box_mm for target in targets])
