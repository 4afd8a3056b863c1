"""Phases on the faces of a region, as kernels read them: profiles, diffraction orders and their shares of the light.

A kernel that follows importance needs the shares of the light, which travels the other way. So the tables say what the
weights of their packets are, see `carrying`.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.kernels.by_address import by_address
from lfmesh.optics.glass import Medium
from lfmesh.optics.phase_profiles import Phases, phase_table
from lfmesh.scene import Scene
from lfmesh.scene.camera.phase import Phase
from lfmesh.transport.tables.media import with_media
from lfmesh.transport.tables.tables import NO_SLOT, Camera, Interfaces, Tables

Array = NDArray[np.float64]

FIRST_TRANSMITTED, FIRST_REFLECTED, END_OF_ORDERS = 0, 1, 2
"""Columns of `PhaseFaces.first`; the first two are also those of `PhaseFaces.left`."""

EVANESCENT_ORDERS, UNLISTED_ORDERS = 0, 1
"""Columns of `PhaseFaces.slot`."""

Region = TypeVar("Region", Tables, Camera)


@by_address
class PhaseFaces(NamedTuple):
    """Phases on the faces of a region.

    The main order of a face is the first of its transmitted orders; the zeroth, if listed, the first of its reflected
    ones.
    """

    number: NDArray[np.int64]  # (rows,) number of the phase of each interface; −1: none
    phases: Phases
    # (wavelengths,) mm, wavelength over 2π: times the gradient of a phase, in rad/mm, it is the change of momentum in
    # the first order
    scale: Array
    order: Array  # (orders,) numbers of the orders of all faces
    share: Array  # (orders, wavelengths) share of each in the transmitted, or the reflected, light of its face
    first: NDArray[np.int64]  # (rows, 3) begin of a face's transmitted orders, of its reflected ones, and their end
    left: Array  # (rows, 2, wavelengths) share of the transmitted and of the reflected light in no listed order
    slot: NDArray[np.int64]  # (rows, 2) book slots of evanescent orders and of light in no listed order
    power: Array  # (rows, wavelengths) 1/mm, first-order power in the main order
    tilt: Array  # (rows, 2) rad/mm, gradient at the vertex, times the main order
    revolved: bool  # whether all phases are symmetrical about the axes of their faces
    several: bool  # whether any face sends light into more than one transmitted and the zeroth reflected order
    against_light: bool = False  # whether packets carry importance, so that light travels the other way


def lost_orders(name: str) -> tuple[str, str]:
    """Return the ledger's names of light lost at a face with a phase: in evanescent and in unlisted orders."""
    return f"evanescent orders of {name}", f"unlisted orders of {name}"


def has_several_orders(phase: Phase) -> bool:
    """Tell whether a phase sends light into more than one transmitted and the zeroth reflected order."""
    return not phase.has_one_order or tuple(phase.reflected()) != ((0, 1.0),)


def phase_faces(
    phases: Sequence[Phase | None],
    media: Sequence[tuple[Medium, Medium]],
    names: Sequence[str],
    wavelengths_nm: Sequence[float],
    slots: Mapping[str, int],
) -> PhaseFaces | None:
    """Return the phases of a region's faces; None if no face has one.

    Parameters
    ----------
    phases : sequence of phase or None
        Phase of each face.
    media : sequence of (Medium, Medium)
        Media on both sides of each face.
    names : sequence of str
        Names of the faces in the ledger.
    wavelengths_nm : sequence of float
    slots : mapping of str to int
        Slots of the book by name, see `lost_orders`.
    """
    given = [phase for phase in phases if phase is not None]
    if not given:
        return None
    rows, colours = len(phases), len(wavelengths_nm)
    number, first = np.full(rows, -1, np.int64), np.zeros((rows, 3), np.int64)
    slot, left = np.full((rows, 2), NO_SLOT, np.int64), np.zeros((rows, 2, colours))
    power, tilt = np.zeros((rows, colours)), np.zeros((rows, 2))
    orders: list[int] = []
    shares: list[list[float]] = []
    for row, (phase, sides, name) in enumerate(zip(phases, media, names, strict=True)):
        if phase is None:
            continue
        number[row] = int((number >= 0).sum())
        first[row, FIRST_TRANSMITTED] = len(orders)
        reflected = [dict(phase.reflected())] * colours
        for way, by_colour, main in (
            (FIRST_TRANSMITTED, [dict(phase.orders_of(w, *sides)) for w in wavelengths_nm], phase.main_order),
            (FIRST_REFLECTED, reflected, 0),
        ):
            seen = {m for each in by_colour for m in each}
            listed = [*seen & {main}, *sorted(seen - {main})]
            orders += listed
            shares += [[each.get(m, 0.0) for each in by_colour] for m in listed]
            left[row, way] = [max(0.0, 1.0 - math.fsum(each.values())) for each in by_colour]
            first[row, way + 1] = len(orders)
        slot[row] = [slots.get(lost, NO_SLOT) for lost in lost_orders(name)]
        power[row] = [phase.power_per_mm(wavelength_nm) for wavelength_nm in wavelengths_nm]
        tilt[row] = np.multiply(phase.main_order, phase.gradient_rad_mm)
    return PhaseFaces(
        number=number,
        phases=phase_table([phase.profile() for phase in given]),
        scale=np.array(wavelengths_nm) * (1e-6 / (2.0 * np.pi)),
        order=np.array(orders, np.float64),
        share=np.array(shares).reshape(-1, colours),
        first=first,
        left=left,
        slot=slot,
        power=power,
        tilt=tilt,
        revolved=all(phase.of_revolution for phase in given),
        several=any(map(has_several_orders, given)),
    )


def spreads_light(interfaces: Interfaces) -> bool:
    """Tell whether a face of a region sends a ray in more than one transmitted direction: it is rough, or has orders.

    No search by single rays then bounds the directions that light comes from.
    """
    return interfaces.rough or (interfaces.phases is not None and interfaces.phases.several)


def is_revolved_by_phase(interfaces: Interfaces) -> bool:
    """Tell whether the phases of a region, if any, are symmetrical about the axes of their faces."""
    return interfaces.phases is None or interfaces.phases.revolved


def most_orders(tables: Tables) -> int:
    """Return the largest number of orders, transmitted and reflected, at a face of lens or array; 0 without phases."""
    phases = [part.interfaces.phases for part in (tables.lens, tables.mla)]
    return max(
        (
            int((each.first[:, END_OF_ORDERS] - each.first[:, FIRST_TRANSMITTED]).max())
            for each in phases
            if each is not None
        ),
        default=0,
    )


def first_order(interfaces: Interfaces, row: int, colour: int) -> tuple[float, float, float]:
    """Return the power, 1/mm, of a face's phase in its main order, and the change of momentum at the vertex in x and y.

    All are 0 without a phase.

    Parameters
    ----------
    interfaces : Interfaces
    row, colour : int
        Number of the interface, and of the wavelength.
    """
    phases = interfaces.phases
    if phases is None:
        return 0.0, 0.0, 0.0
    gx, gy = (float(phases.scale[colour] * each) for each in phases.tilt[row])
    return float(phases.power[row, colour]), gx, gy


def carrying(tables: Region, *, importance: bool) -> Region:
    """Return tables for packets or rays that carry importance, against the light, or else power.

    The tables are the same if no face has a phase.

    Parameters
    ----------
    tables : Tables or Camera
    importance : bool
    """
    lens, mla = (weighing(part.interfaces, importance=importance) for part in (tables.lens, tables.mla))
    if lens is not tables.lens.interfaces:
        tables = tables._replace(lens=tables.lens._replace(interfaces=lens))
    if mla is not tables.mla.interfaces:
        tables = tables._replace(mla=with_media(tables.mla, tables.mla.media, interfaces=mla))
    return tables


def weighing(interfaces: Interfaces, *, importance: bool) -> Interfaces:
    """Return the interfaces of a region for weights that are importance, or else power; see `carrying`."""
    phases = interfaces.phases
    if phases is None or phases.against_light == importance:
        return interfaces
    return interfaces._replace(phases=phases._replace(against_light=importance))


def of_faces(interfaces: Interfaces, first: int, last: int) -> Interfaces:
    """Return the table of consecutive interfaces.

    Parameters
    ----------
    interfaces : Interfaces
    first, last : int
        First interface, and end of the interfaces (excluded).
    """
    kept = interfaces._replace(rows=interfaces.rows[first:last])
    phases = interfaces.phases
    if phases is None:
        return kept
    mine = {name: getattr(phases, name)[first:last] for name in ("number", "first", "left", "slot", "power", "tilt")}
    return kept._replace(phases=phases._replace(**mine))


def at_colours(phases: PhaseFaces | None, colours: NDArray[np.intp], outside: Array) -> PhaseFaces | None:
    """Return phases at some wavelengths, for indices relative to that of the medium outside.

    Parameters
    ----------
    phases : PhaseFaces or None
    colours : (n,) int
        Numbers of the wavelengths.
    outside : (n,) float64
        Refractive index of the medium outside.
    """
    if phases is None:
        return None
    return phases._replace(
        scale=phases.scale[colours] / outside,
        share=np.ascontiguousarray(phases.share[:, colours]),
        left=np.ascontiguousarray(phases.left[:, :, colours]),
        power=np.ascontiguousarray(phases.power[:, colours] / outside),
    )


def slots_of(interfaces: Interfaces) -> Array | NDArray[np.int64]:
    """Return the book slots of a region's interfaces, (n,) int64."""
    slots = interfaces.rows["slot"]
    return slots if interfaces.phases is None else np.append(slots, interfaces.phases.slot)


def has_phases(scene: Scene) -> bool:
    """Tell whether a face of the camera has a phase."""
    return any(True for _ in scene.phases())


def has_orders(scene: Scene) -> bool:
    """Tell whether a phase of the camera has several orders, so that rays are not aimed."""
    return any(has_several_orders(phase) for _, phase, _, _ in scene.phases())


def refuse_diffracting_phases(scene: Scene) -> None:
    """Refuse lenslets that diffract and have a phase.

    Raises
    ------
    SceneError
    """
    if scene.camera.mla is None or scene.transport.diffraction != "lenslets":
        return
    for name in scene.camera.mla.phases:
        raise SceneError(
            f'transport.diffraction = "lenslets" with camera.mla.{name}: the change of direction is proven for '
            'lenslets without a phase only; use diffraction = "none"'
        )
