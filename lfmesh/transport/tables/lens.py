"""Tables of lens and array for kernels: surfaces, facets, media."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.array.array_mesh import OFFSET, cell_mesh
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.array.lenslets import Lenslets, lenslets
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.lens.lens_shape import LensShape
from lfmesh.geometry.meshes.levels import EXACT, PATCH
from lfmesh.geometry.meshes.mesh import Array, Mesh, facet_table, joined
from lfmesh.geometry.meshes.patch import neighbours, patches
from lfmesh.geometry.meshes.patch_bends import control_points
from lfmesh.geometry.meshes.patch_tree import patch_tree
from lfmesh.geometry.surfaces.bends import box_of, powers_of
from lfmesh.geometry.surfaces.surface import CONIC_AND_EVEN
from lfmesh.geometry.surfaces.tessellation import FLOAT32_MARGIN, OVERREACH
from lfmesh.optics.bounds import SLOPE, profile_extremes
from lfmesh.optics.diffraction import HEXAGON, RECTANGLE, ROUND, airy_quantiles, hexagon_cells, sinc2_quantiles
from lfmesh.scene import MicrolensArray, Scene
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.transport.packets.book import MOUNT, STOP, Book
from lfmesh.transport.packets.packet import (
    BACK_CELLS,
    BACK_CELLS_MESH,
    BACK_FACE,
    BACK_FRAME,
    CELLS,
    CELLS_MESH,
    CURVED_FACE,
    MLA_FRAME,
)
from lfmesh.transport.tables.gradient_spaces import gradient_spaces
from lfmesh.transport.tables.media import MediumList, with_media
from lfmesh.transport.tables.phase_faces import refuse_diffracting_phases
from lfmesh.transport.tables.tables import (
    AIR,
    CURVED_ROW,
    FACES_OF_ARRAY,
    FACES_OF_COVER,
    FLAT_ROW,
    Apertures,
    Interfaces,
    LensTables,
    Media,
    MlaTables,
)

SLOPE_WITHIN = 0.01
"""Relative excess, at most, of the bound of a surface's slope over its largest slope."""

NO_CELLS = np.empty((0, 2), np.float32)
"""Placeholder for the table of a hexagon's cells."""

LEAST_LEVER = 0.2
"""Least slope behind an array with two faces, over the slope before it, for the computation of `Apertures.lever`."""

STEEPER = 1e-9
"""Margin in dz for rays steeper than a surface."""


def lens_tables(
    scene: Scene,
    shape: LensShape,
    wavelengths_nm: tuple[float, ...],
    book: Book,
    interfaces: Interfaces,
    known: MediumList,
) -> tuple[Mesh, LensTables]:
    """Return the facets of the lens as one mesh for Embree, and its tables.

    Parameters
    ----------
    scene : Scene
    shape : LensShape
    wavelengths_nm : (wavelengths,) tuple of float
    book : Book
    interfaces : Interfaces
        One row per refracting surface.
    known : MediumList
    """
    count = len(shape.caps)
    mesh = joined([*shape.caps, *shape.closures])
    bodies = np.repeat(
        [*range(count), *(-1 - s for s in range(1, count))],
        [len(m.faces) for m in (*shape.caps, *shape.closures)],
    )
    ring_slot = np.full(count + 1, MOUNT)
    ring_slot[np.array(shape.elements, dtype=np.int64) + 1] = book.edges
    stop_space, stop_z, stop_radius, stop_pose = _pure_stop(scene, shape)
    facets = facet_table(mesh, bodies.astype(np.int64))
    patches_, across = curved(bool((shape.surfaces["level"] == PATCH).any()), mesh)
    # Rings have negative numbers, and use the last entry.
    of_patches = np.append(shape.surfaces["level"] == PATCH, False)[np.maximum(facets["body"], -1)]
    bulges = control_points(patches_[of_patches]).reshape(-1, 3) if len(patches_) else np.zeros((0, 3))
    caps = np.concatenate([outermost(shape), bulges])
    # Larger by a rounding error, so that even a flat surface has a box that rays can enter.
    slack = 1e-9 * np.abs(caps).max()
    first, last = shape.surfaces[0], shape.surfaces[-1]
    inside = [known.in_camera(each) for each in shape.media[1:-1]]
    medium = np.array([known.before_lens, *inside, known.behind_lens])
    media = known.table(wavelengths_nm, book, medium.tolist())
    order, by_roots, ordered = surface_order(shape)
    return mesh, LensTables(
        surfaces=shape.surfaces,
        patches=patches_,
        across=across,
        tree=patch_tree(patches_, facets["corners"], facets["body"], of_patches),
        facets=facets,
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
        by_roots=by_roots,
        gradients=gradient_spaces(scene, shape, wavelengths_nm),
    )


def outermost(shape: LensShape) -> Array:
    """Return points (n, 3), camera frame, mm, that bound all exact and flat surfaces of a lens.

    A conic without a pose is outermost at vertices of its mesh (vertex or rim). For other exact surfaces boxes are
    computed.

    Parameters
    ----------
    shape : LensShape
    """
    boxes = [
        box_of(surface, rim)
        for surface, rim in zip(shape.surfaces, shape.rims, strict=True)
        if surface["level"] == EXACT and (surface["terms"] > 0 or surface["posed"])
    ]
    return np.concatenate([*(cap.vertices for cap in shape.caps), *boxes])


def surface_order(shape: LensShape) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the bounds of each space of the lens, for rays traced without its mesh.

    Parameters
    ----------
    shape : LensShape

    Returns
    -------
    order : (K + 1, 12) float64
        Columns 0 to 3: curvature, 1 + conic constant, z of the vertex and squared radius of the aperture for the
        surface towards the object; NaN without such a surface. Columns 4 to 7: the same for the surface towards the
        sensor. Column 8: squared radius of a cylinder about the axis, clear of the space's ring; a straight line
        between two points in it does not meet the ring. Column 9: |dz| above which a ray crosses each surface of the
        space at most once, and in the sense of dz, so that it can only meet the surface ahead; inf: unknown. Columns 10
        and 11: the same |dz| for the surface towards the object, and towards the sensor.
    by_roots : (K + 1,) bool
        The surfaces of the space are exact conics without a pose, so that their roots decide the first hit.
    ordered : (K + 1,) bool
        The first hit of some rays is known without the mesh: of rays steeper than the surfaces and, between conics, of
        rays decided by the roots. In gradient-index glass that of all rays is, but no straight line finds it.
    """
    count, surfaces = len(shape.caps), shape.surfaces
    conic = (surfaces["level"] == EXACT) & (surfaces["terms"] == 0)
    order = np.full((count + 1, 12), np.nan)
    order[:, 8] = np.inf
    each = (surfaces["curvature"], 1.0 + surfaces["conic"], surfaces["vertex_z"], surfaces["semi_diameter"] ** 2)
    order[1:, :4] = order[:-1, 4:8] = np.stack(each, axis=1)
    # The ring is in float32.
    smaller = np.minimum(shape.rims[:-1], shape.rims[1:])
    free = [_free_radius(ring, rim) for ring, rim in zip(shape.closures, smaller, strict=True)]
    order[1:-1, 8] = ((1.0 - 2.0 * FLOAT32_MARGIN) * np.array(free)) ** 2
    least = np.array([least_dz(s, rim) for s, rim in zip(surfaces, shape.rims, strict=True)])
    order[:, 10], order[:, 11] = [0.0, *least], [*least, 0.0]
    order[:, 9] = np.maximum(order[:, 10], order[:, 11])
    straight = np.array([not isinstance(medium, Gradient) for medium in shape.media])
    order[~straight, 9] = np.inf
    by_roots = _everywhere(conic & (surfaces["posed"] == 0)) & straight
    return order, by_roots, _everywhere(conic) | (order[:, 9] < 1.0) | ~straight


def _everywhere(holds: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether a property of surfaces holds for all surfaces of each space, (K + 1,)."""
    return np.append(True, holds) & np.append(holds, True)


def _free_radius(ring: Mesh, rim: float) -> float:
    """Return the radius, mm, of the largest cylinder about the z axis inside a ring around it.

    If the surfaces meet at their rims there is no ring; the space ends at the smaller `rim`.
    """
    if not len(ring.faces):
        return rim
    corners = ring.vertices[ring.faces][:, :, :2]
    a, along = corners, np.roll(corners, -1, axis=1) - corners
    length2 = np.maximum(np.sum(along * along, axis=2), np.finfo(np.float64).tiny)
    t = np.clip(-np.sum(a * along, axis=2) / length2, 0.0, 1.0)
    return float(np.linalg.norm(a + t[:, :, None] * along, axis=2).min())


def least_dz(surface: np.void, rim: float) -> float:
    """Return the |dz| above which a ray is steeper than a surface everywhere inside its rim; inf: none.

    Only for conics and even terms. Along such a ray the height over the surface changes in one sense only. In the
    camera frame: the tilt of the surface is added to its slope.

    Parameters
    ----------
    surface : SURFACE record
    rim : float, mm
        Radius of its mesh.
    """
    if surface["level"] != EXACT or surface["kind"] != CONIC_AND_EVEN:
        return np.inf
    steepest = steepest_slope(surface, rim)
    if not steepest < np.inf:
        return np.inf
    angle = np.arctan(steepest) + np.arcsin(min(1.0, float(np.hypot(*surface["pose"][:2, 2]))))
    return float(np.sin(angle)) + STEEPER if angle < 0.5 * np.pi else np.inf


def steepest_slope(surface: np.void, rim: float) -> float:
    """Return an upper bound of a surface's slope |dz/dr| inside a radius; inf if the surface ends before.

    Parameters
    ----------
    surface : SURFACE record
    rim : float, mm
    """
    radius, c, k = rim * (1.0 + OVERREACH), float(surface["curvature"]), float(surface["conic"])
    if not (1.0 + k) * (c * radius) ** 2 < 1.0:
        return np.inf
    least, most = profile_extremes((c, c), k, powers_of(surface), radius, (SLOPE,), SLOPE_WITHIN)
    return max(-least, most)


def _pure_stop(scene: Scene, shape: LensShape) -> tuple[int, float, float, frame.Frame]:
    """Return space, z, radius (mm) and pose of a stop that is not a refracting surface; space −1 without one."""
    prescription = scene.camera.lens
    for i, s in enumerate(prescription.surfaces):
        if prescription.is_pure_stop(i):
            space = sum(number < i for number in shape.numbers)
            return space, prescription.vertices_mm[i], float(s.semi_diameter_mm or np.inf), pose_of(prescription, i)
    return -1, 0.0, np.inf, frame.IDENTITY


def mla_tables(
    scene: Scene, wavelengths_nm: tuple[float, ...], interfaces: Interfaces, known: MediumList,
    book: Book | None = None,
) -> tuple[dict[int, Mesh], MlaTables]:  # fmt: skip
    """Return the meshes of cells for Embree, by station, and the tables of the array.

    A mesh has one cell per lenslet type, side by side. An array with lenslets on both faces has two meshes. A flat face
    with a phase, or of a gradient-index plate, counts as a face of flat lenslets.

    Parameters
    ----------
    scene : Scene
    wavelengths_nm : (wavelengths,) tuple of float
    interfaces : Interfaces
        `CURVED_ROW` and `FLAT_ROW`.
    known : MediumList
    book : Book, optional
        Without it, the array does not absorb.
    """
    mla = scene.camera.mla
    medium = known.in_camera(mla.medium) if mla is not None else AIR
    media = known.table_behind_lens(wavelengths_nm, book, (medium,))
    if mla is None:
        nothing = lenslets(Lattice(False, 1.0, 1, 1), np.array([np.inf]), 1.0)
        empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
        return {CELLS: empty}, _cells(False, False, nothing, empty, 0.0, media, AIR, interfaces, True)
    shapes = curved_lenslets(mla)
    is_curved, to_lens = scene.transport.surface == "patch", mla.curved_side == "lens"
    shift, mesh = OFFSET * shapes.lattice.pitch, _cells_side_by_side(shapes)
    tables = _cells(is_curved, True, shapes, mesh, shift, media, medium, interfaces, to_lens)
    other = other_lenslets(mla, shapes)
    if other is None:
        return {CELLS: mesh}, tables
    other_mesh = _cells_side_by_side(other)
    back = _cells(is_curved, True, other, other_mesh, shift, media, medium, interfaces, not to_lens)
    back = back._replace(row=FLAT_ROW, face=BACK_FACE)
    if to_lens:
        tables, back, mesh, other_mesh = back, tables, other_mesh, mesh
    back = back._replace(frame=BACK_FRAME, cells=BACK_CELLS, cells_mesh=BACK_CELLS_MESH)
    return {CELLS: mesh, BACK_CELLS: other_mesh}, tables._replace(back=back)


def with_diffraction(scene: Scene, mla: MlaTables, wavelengths_nm: tuple[float, ...]) -> MlaTables:
    """Add apertures to the array's tables if the scene asks for diffraction at the lenslets.

    Parameters
    ----------
    scene : Scene
    mla : MlaTables
    wavelengths_nm : (wavelengths,) tuple of float

    Raises
    ------
    SceneError
        The array has a phase.
    """
    given = scene.camera.mla
    if given is None or scene.transport.diffraction != "lenslets":
        return mla
    refuse_diffracting_phases(scene)
    face, lever = _limiting_face(given, mla, len(wavelengths_nm) // 2)
    clear = mla.lenslets.clear_radius if mla.row == CURVED_ROW else mla.back.lenslets.clear_radius
    if face.row == CURVED_ROW and clear < np.inf:
        shape, width, quantiles = ROUND, 2.0 * clear, airy_quantiles()
    else:
        shape, quantiles = (HEXAGON if given.layout == "hexagonal" else RECTANGLE), sinc2_quantiles()
        width = given.pitch_mm * (1.0 + given.form.pitch_error)
    # A cylinder ends with the array along its axis.
    axis = given.cylinder_axis if face.row == CURVED_ROW or given.back is None else given.back.cylinder_axis
    # Wavelengths in the medium outside the plate, where directions change.
    waves = np.array(wavelengths_nm) * 1e-6 / mla.media.indices[AIR]
    spread = np.outer(waves, [float(axis != each) for each in "xy"]) / width
    cells = hexagon_cells() if shape == HEXAGON else NO_CELLS
    # Interfaces of the cover and, for lenslets that face the lens, of the array; others diffract a packet before.
    events = _events_in_cover(scene) + (FACES_OF_ARRAY if face.curved_to_lens else 0)
    apertures = Apertures(shape, spread, quantiles, cells, int(face.row), bool(face.curved_to_lens), events, lever)
    return with_media(mla, mla.media, apertures=apertures)


def with_diffracting_stop(scene: Scene, lens: LensTables, wavelengths_nm: tuple[float, ...]) -> LensTables:
    """Add the stop's aperture to the lens's tables if the scene asks for its diffraction.

    Parameters
    ----------
    scene : Scene
    lens : LensTables
    wavelengths_nm : (wavelengths,) tuple of float
    """
    if scene.transport.diffraction != "stop":
        return lens
    space, radius = lens.stop_space, lens.stop_radius
    if space < 0:
        # A surface is the stop.
        space = int(np.argmax(lens.surfaces["stop"] == 1))
        radius = float(lens.surfaces["semi_diameter"][space])
    spread = np.outer(wavelengths_nm, (1.0, 1.0)) * 1e-6 / (2.0 * radius)
    events = _events_in_cover(scene) + len(lens.surfaces) - space
    aperture = Apertures(ROUND, spread, airy_quantiles(), NO_CELLS, -1, False, events, 0.0)
    return _with_stop_in_box(lens)._replace(aperture=aperture)


def _with_stop_in_box(lens: LensTables) -> LensTables:
    """Return the tables with a box that holds a stop in front of all surfaces: rays enter the lens where they may turn.

    A ray through such a stop may miss the surfaces unless the stop deflects it.
    """
    if lens.stop_space != 0:
        return lens
    corners = lens.stop_radius * np.array([(x, y, 0.0) for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
    corners[:, 2] = lens.stop_z
    if lens.stop_posed:
        corners = frame.points(lens.stop_pose, corners)
    return lens._replace(
        box_low=np.minimum(lens.box_low, corners.min(axis=0)),
        box_high=np.maximum(lens.box_high, corners.max(axis=0)),
    )


def _events_in_cover(scene: Scene) -> int:
    """Return the number of interfaces in the sensor's cover."""
    return 0 if scene.camera.sensor.cover is None else FACES_OF_COVER


def _limiting_face(given: MicrolensArray, mla: MlaTables, colour: int) -> tuple[MlaTables, float]:
    """Return the face with the limiting apertures, which diffract, and the lever of `Apertures`.

    Of two faces with lenslets it is the smaller one for light along the axis (paraxial, with mean curvatures).

    Parameters
    ----------
    given : MicrolensArray
    mla : MlaTables
    colour : int
        Number of the wavelength.
    """
    if mla.back is None:
        return mla, 1.0
    outside = mla.media.indices[AIR, colour]
    index, pitch = float(mla.media.indices[mla.medium, colour] / outside), given.pitch_mm
    reduced = mla.lenslets.thickness / index
    at_lens, at_sensor = (
        1.0 - reduced * (index - 1.0) * float(each.lenslets.curvature.mean()) for each in (mla.back, mla)
    )
    curved, flat = given.clear_diameter_mm or pitch, pitch
    first, second = (curved, flat) if mla.back.row == CURVED_ROW else (flat, curved)
    if second < first * abs(at_lens):
        return mla, 1.0
    return mla.back, float(np.copysign(1.0 / max(abs(at_sensor), LEAST_LEVER), at_sensor))


def curved_lenslets(mla: MicrolensArray) -> Lenslets:
    """Return the lenslets of the curved face of an array; without a radius they are flat."""
    lattice = Lattice(
        mla.layout == "hexagonal", mla.pitch_mm * (1.0 + mla.form.pitch_error), mla.count[0], mla.count[1]
    )
    shapes = lenslets(
        lattice,
        np.asarray(mla.radii_mm, dtype=np.float64),
        mla.thickness_mm,
        decenter_mm=mla.form.decenter_mm,
        radius_error=mla.form.radius_error,
        seed=mla.form.seed,
        conic=mla.conic,
        asphere_mm=mla.asphere_mm,
        cylinder_axis=mla.cylinder_axis,
    )
    if mla.clear_diameter_mm is not None:
        shapes = shapes._replace(clear_radius=0.5 * float(mla.clear_diameter_mm))
    return shapes


def other_lenslets(mla: MicrolensArray, front: Lenslets) -> Lenslets | None:
    """Return the lenslets of the face opposite the curved face; None if it is flat and `turns_twice` is not set.

    Parameters
    ----------
    mla : MicrolensArray
    front : Lenslets
        Of the curved face.

    Raises
    ------
    SceneError
        The layers of the two faces overlap.
    """
    if not mla.turns_twice:
        return None
    if mla.has_back and mla.back is not None:
        form = mla.back
        other = lenslets(
            front.lattice,
            np.array([form.radius_mm]),
            mla.thickness_mm,
            conic=(form.conic,),
            asphere_mm=(form.asphere_mm,),
            cylinder_axis=form.cylinder_axis,
        )
    else:
        other = lenslets(front.lattice, np.array([np.inf]), mla.thickness_mm)
    if front.valley + other.valley >= mla.thickness_mm:
        raise SceneError(
            f"camera.mla.thickness_mm = {mla.thickness_mm:g}: the lenslets of the two faces are up to "
            f"{front.valley:.4g} mm and {other.valley:.4g} mm deep and would meet in the plate; give a thicker array, "
            "larger radii or smaller form errors"
        )
    return other


def _cells_side_by_side(shapes: Lenslets) -> Mesh:
    """Return one cell per lenslet type, joined in one mesh."""
    shift = OFFSET * shapes.lattice.pitch
    cells = [cell_mesh(shapes, kind) for kind in range(len(shapes.curvature))]
    return joined(
        Mesh(np.add(c.vertices, [kind * shift, 0.0, 0.0]), c.faces, c.corner_normals) for kind, c in enumerate(cells)
    )


def _cells(
    is_curved: bool, present: bool, shapes: Lenslets, mesh: Mesh, shift: float, media: Media, medium: int,
    interfaces: Interfaces, curved_to_lens: bool,
) -> MlaTables:  # fmt: skip
    """Return the tables of the array's face described by `camera.mla`."""
    facets = facet_table(mesh, np.zeros(len(mesh.faces), np.int64))
    patches_, across = curved(is_curved, mesh)
    return MlaTables(
        present=present,
        lenslets=shapes,
        patches=patches_,
        across=across,
        tree=patch_tree(patches_, facets["corners"], facets["body"], np.full(len(facets), is_curved)),
        facets=facets,
        type_shift=shift,
        media=media,
        medium=medium,
        interfaces=interfaces,
        curved_to_lens=curved_to_lens,
        frame=MLA_FRAME,
        cells=CELLS,
        cells_mesh=CELLS_MESH,
        row=CURVED_ROW,
        face=CURVED_FACE,
    )


def curved(needed: bool, mesh: Mesh) -> tuple[Array, NDArray[np.int64]]:
    """Return the curved patches of a mesh and their neighbours; empty if not needed."""
    if not needed or mesh.corner_normals is None:
        return np.zeros((0, 6, 3)), np.zeros((0, 3), np.int64)
    return patches(mesh.vertices[mesh.faces], mesh.corner_normals), neighbours(mesh.faces, mesh.corner_normals)
