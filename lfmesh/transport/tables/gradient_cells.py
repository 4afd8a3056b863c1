"""Gradient-index plates of microlens arrays, as kernels read them: profiles, steps, and the axis of each lenslet.

The number of steps comes from probe rays through a lenslet of each type, once for each wavelength.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import GlassError, SceneError
from lfmesh.geometry.array.gradient_cell import BACK, FRONT, follow_rays_in_cell
from lfmesh.geometry.array.lenslets import Lenslets, faces_at, type_of
from lfmesh.optics.gradient_path import PROBE_PRECISION, arriving_probes, least_steps, starting_rays, steps_needed
from lfmesh.optics.gradient_shapes import GradientProfile
from lfmesh.optics.gradients import fields_at, gradient_table
from lfmesh.scene import Scene
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.gradient_regions import cell_regions
from lfmesh.scene.camera.mla import ArrayForm, MicrolensArray
from lfmesh.transport.tables.tables import AIR, CURVED_ROW, CellGradients, MlaTables

Array = NDArray[np.float64]

PLACES = (0.0, 0.5, 0.95)
"""Starts of probe rays, from the axis to a corner of the cell."""

SINES = (0.0, 0.3, 0.6, 0.95)
"""Sines of the angles at which probe rays come from outside."""

TURNS = 4
"""Azimuths of the directions of probe rays."""

WIDER = 1.25
"""Factor on the cells in which probe rays that arrive are compared."""

STEEPEST = 0.95
"""Largest sine of an acceptance."""


def with_gradient_cells(scene: Scene, mla: MlaTables, wavelengths_nm: tuple[float, ...]) -> MlaTables:
    """Add the gradient of the plate to the tables of the array, for both faces, if it has one.

    Parameters
    ----------
    scene : Scene
    mla : MlaTables
    wavelengths_nm : (wavelengths,) tuple of float

    Raises
    ------
    SceneError
        An index is not real in all of a cell, or changes too fast.
    """
    given = scene.camera.mla
    if given is None or given.gradient is None:
        return mla
    profiles = [given.gradient.profile(wavelength_nm) for wavelength_nm in wavelengths_nm]
    curved, outside = mla if mla.row == CURVED_ROW else mla.back, mla.media.indices[AIR]
    try:
        _check_form(given, given.gradient, curved.lenslets, wavelengths_nm)
        found = [_of_wavelength(profile, mla, float(n)) for profile, n in zip(profiles, outside, strict=True)]
    except GlassError as error:
        raise SceneError(f"camera.mla.gradient: {error}") from error
    steps, longest, acceptance = zip(*found, strict=True)
    cells = CellGradients(
        gradients=gradient_table(profiles),
        steps=np.array(steps, np.int64),
        longest=np.array(longest),
        outside=outside,
        acceptance=np.array(acceptance),
        axes=curved.lenslets.decentre,
        opposite=mla.back.lenslets,
        clear_walls=given.walls == "clear",
    )
    return _with_cells(mla, cells)


def _check_form(
    mla: MicrolensArray, gradient: Gradient, lenslets: Lenslets, wavelengths_nm: tuple[float, ...]
) -> None:  # fmt: skip
    """Refuse an index that leaves the valid range in a cell with errors of form.

    Parameters
    ----------
    mla : MicrolensArray
    gradient : Gradient
    lenslets : Lenslets
        Of the curved face, with the errors.
    wavelengths_nm : (wavelengths,) tuple of float
    """
    if mla.form == ArrayForm():
        return
    # The axis of a decentred lenslet lies nearer to one wall, and farther from the opposite one.
    pitch = lenslets.lattice.pitch + 2.0 * float(np.abs(lenslets.decentre).max(initial=0.0))
    stretches = (float(lenslets.stretch.min()), float(lenslets.stretch.max())) if len(lenslets.stretch) else (1.0,)
    for region in cell_regions(mla, pitch, stretches):
        gradient.check_region(region)
        for wavelength_nm in wavelengths_nm:
            gradient.check_within(wavelength_nm, region)


def at_colours(mla: MlaTables, colours: NDArray[np.int64]) -> MlaTables:
    """Return the tables of the array with its gradient, if any, at some of the wavelengths.

    Parameters
    ----------
    mla : MlaTables
    colours : (n,) int64
        Numbers of the wavelengths.
    """
    cells = mla.gradient
    if cells is None:
        return mla
    gradients = cells.gradients._replace(rows=cells.gradients.rows[colours])
    by_colour = {name: getattr(cells, name)[colours] for name in ("steps", "longest", "outside", "acceptance")}
    return _with_cells(mla, cells._replace(gradients=gradients, **by_colour))


def _with_cells(mla: MlaTables, cells: CellGradients) -> MlaTables:
    """Return the tables of the array with a gradient, given as seen from the face towards the sensor."""
    back = mla.back._replace(gradient=cells._replace(opposite=mla.lenslets))
    return mla._replace(gradient=cells, back=back)


def _of_wavelength(profile: GradientProfile, mla: MlaTables, outside: float) -> tuple[int, float, float]:
    """Return the number of steps through a plate, the longest step in σ, mm, and the acceptance, see `CellGradients`.

    Parameters
    ----------
    profile : GradientProfile
    mla : MlaTables
        Of the face towards the sensor.
    outside : float
        Index of the medium around the plate.
    """
    gradients, front, back = gradient_table([profile]), mla.back.lenslets, mla.lenslets
    points, directions, cells, start = _probes(front, back, outside)
    squares = fields_at(gradients, 0, points)[:, 0]
    if not (squares > 0.0).all():
        x, y, z = points[int(np.argmin(np.where(np.isfinite(squares), squares, -np.inf)))]
        raise GlassError(
            f"n² = {squares.min():.6g} at {np.hypot(x, y):.4g} mm from the axis of a lenslet, {z:.4g} mm behind its "
            "vertex; the index must be real in all of the plate"
        )
    index = np.sqrt(squares)
    across = directions / index[:, None]
    along = np.sqrt(np.maximum(1.0 - (across * across).sum(axis=1), 0.1))
    rays = starting_rays(gradients, 0, points, np.column_stack([across, np.where(start == FRONT, along, -along)]))
    span = front.thickness / float((index * along).min())

    def traced(some: NDArray[np.intp], by: float, steps: int) -> tuple[NDArray[np.bool_], Array]:
        lattice = front.lattice._replace(pitch=by * front.lattice.pitch)
        ends, walls = rays[some], np.zeros(len(some), np.int64)
        follow_rays_in_cell(
            gradients, 0, front._replace(lattice=lattice), back, cells[some], ends, walls, span / steps, steps
        )  # fmt: skip
        return (walls >= FRONT) & (walls != start[some]), ends

    least = least_steps(gradients, 0, points, span, 2.0 * front.lattice.circumradius)
    arriving = np.flatnonzero(
        arriving_probes(lambda count: traced(np.arange(len(rays)), 1.0, count)[0], least)
    )  # fmt: skip
    if not len(arriving):
        raise GlassError("no ray from one face of a lenslet reaches the other one")
    # Rays that just pass a wall would pass it in some numbers of steps only.
    needed = steps_needed(lambda count: traced(arriving, WIDER, count), PROBE_PRECISION * front.thickness)
    steps = max(needed, least)
    # A rod guides rays up to sin² θ = n² − n²(corner); straight rays are limited by its length.
    middle = float(squares[0])
    guided, straight = middle - squares.min(), middle * (2.0 * front.lattice.circumradius / front.thickness) ** 2
    sine = min(np.sqrt(max(guided, straight)) / outside, STEEPEST)
    return steps, span / steps, float(sine / np.sqrt(1.0 - sine * sine))


def _probes(front: Lenslets, back: Lenslets, outside: float) -> tuple[Array, Array, NDArray[np.int64], Array]:
    """Return probe rays from both faces of a lenslet of each type; the first starts on the axis of one.

    Parameters
    ----------
    front, back : Lenslets
        Of the faces towards the lens and towards the sensor.
    outside : float
        Index of the medium around the plate.

    Returns
    -------
    points : (n, 3) float64, mm
        Starts, from the axis and the vertex of the face towards the lens.
    momenta : (n, 2) float64
        Index times direction across the axis.
    cells : (n, 2) int64
        Column and row of the lenslet.
    start : (n,) int64
        Wall of the start, `FRONT` or `BACK`.
    """
    lattice = front.lattice
    corner = lattice.corners()[0]
    turns = 2.0 * np.pi * np.arange(TURNS) / TURNS
    place, sine, turn = (each.ravel() for each in np.meshgrid(PLACES, SINES, turns, indexing="ij"))
    momenta = outside * sine[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    points, cells, start = [], [], []
    for wall, face, other in ((FRONT, front, back), (BACK, back, front)):
        for column, row in _one_of_each_type(face if len(face.curvature) > 1 else other):
            at = np.outer(place, corner)
            kind = type_of(face, column, row)
            sag, _ = faces_at(face, kind, float(face.curvature[kind]), at)
            points.append(np.column_stack([at, sag if wall == FRONT else front.thickness - sag]))
            cells.append(np.tile(np.array([column, row], np.int64), (len(at), 1)))
            start.append(np.full(len(at), wall))
    return np.concatenate(points), np.tile(momenta, (len(points), 1)), np.concatenate(cells), np.concatenate(start)


def _one_of_each_type(lenslets: Lenslets) -> list[tuple[int, int]]:
    """Return column and row of a cell of each type of lenslets in an array."""
    first: dict[int, tuple[int, int]] = {}
    for row in range(lenslets.lattice.rows):
        for column in range(lenslets.lattice.columns):
            first.setdefault(int(type_of(lenslets, column, row)), (column, row))
            if len(first) == len(lenslets.curvature):
                return list(first.values())
    return list(first.values())
