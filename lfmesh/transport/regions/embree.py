"""Embree queries for the first facet on a ray. The only module that imports embreex."""

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Mesh


class Finder:
    """Embree scene of the facets of one region, in the region's frame, rounded to float32.

    Parameters
    ----------
    mesh : Mesh
        All facets of the region; `find` returns their numbers.
    owners : (m,) int64, optional
        Numbers that `find` returns in place of facet numbers.
    """

    def __init__(self, mesh: Mesh, owners: NDArray[np.int64] | None = None) -> None:
        # The last entry is for facet −1, none.
        self._owners = None if owners is None else np.append(owners, -1).astype(np.int32)
        self._scene = EmbreeScene()
        self._empty = len(mesh.faces) == 0
        if not self._empty:
            TriangleMesh(
                self._scene,
                np.ascontiguousarray(mesh.vertices, np.float32),
                np.ascontiguousarray(mesh.faces, np.int32),
            )
            # The scene commits inside its first query, which must not happen in two threads at once.
            self._scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))

    def find(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.int32]:
        """Return the number of the first facet on each ray, −1 for none, (n,). Releases the GIL.

        Parameters
        ----------
        origins, directions : (n, 3) float32, contiguous
        """
        if self._empty:
            return np.full(len(origins), -1, np.int32)
        found: NDArray[np.int32] = self._scene.run(origins, directions)
        return found if self._owners is None else self._owners[found]
