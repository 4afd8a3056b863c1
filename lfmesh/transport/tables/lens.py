"""Tables of lens and array as kernels read them: surfaces, facets, media."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.element_poses import pose_of
from lfmesh.geometry.lattice import Lattice
from lfmesh.geometry.lens_shape import LensShape
from lfmesh.geometry.lenslets import OFFSET, Lenslets, cell_mesh, lenslets
from lfmesh.geometry.levels import EXACT, PATCH
from lfmesh.geometry.mesh import Array, Mesh, facet_table, joined
from lfmesh.geometry.patch import neighbours, patches
from lfmesh.geometry.tessellation import FLOAT32_MARGIN
from lfmesh.scene import Scene
from lfmesh.transport.packets.book import MOUNT, STOP, Book
from lfmesh.transport.tables.media import MediumList
from lfmesh.transport.tables.tables import (
    AIR,
    ArrayTables,
    Interfaces,
    LensTables,
    Media,
)


def lens_tables(
    scene: Scene,
    shape: LensShape,
    wavelengths_nm: tuple[float, ...],
    book: Book,
    interfaces: Interfaces,
    known: MediumList,
) -> tuple[Mesh, LensTables]:
    """Return the facets of the lens as one mesh, for Embree, and the tables of the lens.

    Parameters
    ----------
    scene : Scene
    shape : LensShape
    wavelengths_nm : (wavelengths,) tuple of float
    book : Book
    interfaces : Interfaces
        One row for each refracting surface.
    known : MediumList
        The media of the scene.
    """
    count = len(shape.caps)
    mesh = joined([*shape.caps, *shape.closures])
    bodies = np.repeat(
        [*range(count), *(-1 - s for s in range(1, count))],
        [len(m.faces) for m in (*shape.caps, *shape.closures)],
    )
    ring_slot = np.full(count + 1, MOUNT)
    ring_slot[np.add(shape.elements, 1, dtype=np.int64)] = book.edges
    stop_space, stop_z, stop_radius, stop_pose = _pure_stop(scene, shape)
    caps = np.concatenate([m.vertices for m in shape.caps])
    # Larger by a rounding error, so that a flat surface, too, has a box that rays can enter.
    slack = 1e-9 * np.abs(caps).max()
    first, last = shape.surfaces[0], shape.surfaces[-1]
    patches_, across = curved(bool((shape.surfaces["level"] == PATCH).any()), mesh)
    media, medium = known.table(wavelengths_nm), np.array([known.number(each) for each in shape.media])
    order, ordered = surface_order(shape)
    return mesh, LensTables(
        surfaces=shape.surfaces,
        patches=patches_,
        across=across,
        facets=facet_table(mesh, bodies.astype(np.int64)),
        media=media,
        medium=medium,
        interfaces=interfaces,
        ring_slot=ring_slot.astype(np.int64),
        mount_slot=np.where(shape.surfaces["stop"] == 1, STOP, MOUNT).astype(np.int64),
        stop_space=stop_space,
        stop_z=stop_z,
        stop_radius=stop_radius,
        stop_posed=not np.array_equal(stop_pose, frame.IDENTITY),
        stop_pose=stop_pose,
        stop_unpose=frame.inverse(stop_pose),
        box_low=caps.min(axis=0) - slack,
        box_high=caps.max(axis=0) + slack,
        convex_front=bool(first["curvature"] >= 0 and first["terms"] == 0),
        convex_back=bool(last["curvature"] <= 0 and last["terms"] == 0),
        lost_slot=book.lost_in_spaces,
        order=order,
        ordered=ordered,
    )


def surface_order(shape: LensShape) -> tuple[Array, NDArray[np.bool_]]:
    """Return what bounds each space of the lens, for rays that are traced without its mesh.

    Parameters
    ----------
    shape : LensShape

    Returns
    -------
    order : (K + 1, 9) float64
        Of the surface towards the object and then of the one towards the sensor: curvature, 1 + conic constant, z of
        the vertex, squared radius of the aperture; NaN where there is no such surface. Last, the squared radius of a
        cylinder about the axis that the ring of the space does not enter: a straight line between two points in it
        does not meet the ring.
    ordered : (K + 1,) bool
        Whether the surfaces of the space are exact conics without a pose, so that their roots decide which a ray meets
        first.
    """
    count, surfaces = len(shape.caps), shape.surfaces
    conic = (surfaces["level"] == EXACT) & (surfaces["terms"] == 0) & (surfaces["posed"] == 0)
    order = np.full((count + 1, 9), np.nan)
    order[:, 8] = np.inf
    each = (surfaces["curvature"], 1.0 + surfaces["conic"], surfaces["vertex_z"], surfaces["aperture"] ** 2)
    order[1:, :4] = order[:-1, 4:8] = np.stack(each, axis=1)
    # The ring is made of chords of circles no smaller than the smaller rim, in float32.
    chord = np.cos(np.pi / (6 * shape.rings)) * (1.0 - 2.0 * FLOAT32_MARGIN)
    rims = np.asarray(shape.rims)
    order[1:-1, 8] = (chord * np.minimum(rims[:-1], rims[1:])) ** 2
    ordered = np.ones(count + 1, np.bool_)
    ordered[1:] &= conic
    ordered[:-1] &= conic
    return order, ordered


def _pure_stop(scene: Scene, shape: LensShape) -> tuple[int, float, float, frame.Frame]:
    """Return space, z, radius (mm) and pose of a stop that is not a refracting surface; space −1 if there is none."""
    prescription = scene.camera.lens
    for i, s in enumerate(prescription.surfaces):
        if prescription.is_pure_stop(i):
            space = sum(number < i for number in shape.numbers)
            return space, prescription.vertices_mm[i], float(s.semi_diameter_mm or np.inf), pose_of(prescription, i)
    return -1, 0.0, np.inf, frame.IDENTITY


def array_tables(
    scene: Scene, wavelengths_nm: tuple[float, ...], interfaces: Interfaces, known: MediumList
) -> tuple[Mesh, ArrayTables]:
    """Return one cell for each lenslet type, side by side, as one mesh for Embree, and the tables of the array.

    Parameters
    ----------
    scene : Scene
    wavelengths_nm : (wavelengths,) tuple of float
    interfaces : Interfaces
        `CURVED_ROW` and `FLAT_ROW`.
    known : MediumList
        The media of the scene.
    """
    mla, media = scene.camera.mla, known.table(wavelengths_nm)
    if mla is None:
        nothing = lenslets(Lattice(False, 1.0, 1, 1), np.array([np.inf]), 1.0)
        empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
        return empty, _cells(False, False, nothing, empty, 0.0, media, AIR, interfaces, True)
    lattice = Lattice(
        mla.layout == "hexagonal", mla.pitch_mm * (1.0 + mla.form.pitch_error), mla.count[0], mla.count[1]
    )
    shapes = lenslets(
        lattice,
        np.asarray(mla.radius_mm, dtype=np.float64),
        mla.thickness_mm,
        decenter_mm=mla.form.decenter_mm,
        radius_error=mla.form.radius_error,
        seed=mla.form.seed,
    )
    shift = OFFSET * lattice.pitch
    cells = [cell_mesh(shapes, kind) for kind in range(mla.types)]
    mesh = joined(
        Mesh(np.add(c.vertices, [kind * shift, 0.0, 0.0]), c.faces, c.corner_normals) for kind, c in enumerate(cells)
    )
    is_curved, to_lens = scene.transport.surface == "patch", mla.curved_side == "lens"
    return mesh, _cells(is_curved, True, shapes, mesh, shift, media, known.number(mla.medium), interfaces, to_lens)


def _cells(
    is_curved: bool, present: bool, shapes: Lenslets, mesh: Mesh, shift: float, media: Media, medium: int,
    interfaces: Interfaces, curved_to_lens: bool,
) -> ArrayTables:  # fmt: skip
    bodies = np.zeros(len(mesh.faces), np.int64)
    patches_, across = curved(is_curved, mesh)
    return ArrayTables(
        present=present,
        lenslets=shapes,
        patches=patches_,
        across=across,
        facets=facet_table(mesh, bodies),
        type_shift=shift,
        media=media,
        medium=medium,
        interfaces=interfaces,
        curved_to_lens=curved_to_lens,
    )


def curved(needed: bool, mesh: Mesh) -> tuple[Array, NDArray[np.int64]]:
    """Return the curved patches of a mesh and their neighbours; empty tables where they are not needed."""
    if not needed or mesh.corner_normals is None:
        return np.zeros((0, 6, 3)), np.zeros((0, 3), np.int64)
    return patches(mesh.vertices[mesh.faces], mesh.corner_normals), neighbours(mesh.faces, mesh.corner_normals)
