"""The interface table: the kind of each surface between two media, with its parameters.

A new kind needs an entry in `tables.KINDS`, its parameters in `_parameters`, and its directions in
`transport.events.interface`. The sequential engine uses this table to refuse interfaces that scatter light.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.by_address import by_address
from lfmesh.optics.glass import Medium, refractive_index
from lfmesh.optics.share_table import FROM_THIN, PASSED, TERMS, looked_up
from lfmesh.optics.walsh import diffuse_reflectance
from lfmesh.scene import Scene
from lfmesh.scene.camera.phase import Phase
from lfmesh.scene.materials.coatings import UNCOATED
from lfmesh.scene.materials.finishes import POLISHED, Finish
from lfmesh.transport.packets.book import Book
from lfmesh.transport.tables.coatings import absorbs, coating_table
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.media import MediumList
from lfmesh.transport.tables.phase_faces import has_several_orders, lost_orders, phase_faces
from lfmesh.transport.tables.tables import (
    ABSORBING,
    AIR,
    BARE,
    COATED,
    DIFFUSE,
    GROUND,
    INTERFACE,
    KINDS,
    NO_SLOT,
    ROUGH,
    THIN_LENS,
    Interfaces,
)

POLARISER = "polariser"
"""Name of the polariser in front of the sensor in the ledger."""

_SHOWN_DEG = (0.0, 30.0, 60.0)


class Face(NamedTuple):
    """Interface of a scene.

    Attributes
    ----------
    where : str
        Path in the scene file.
    body : str
        Name of its coating in the ledger.
    coating : str
        Name of its coating, or "none".
    outer, inner : Medium
        Media on the side of its coating's first layer, and on the other.
    finish : Finish
        Of the scene.
    begins_behind : bool
        The first layer of a lens surface is towards the sensor.
    thin_lens_power_per_mm : float, optional
        Power of a thin lens in place of an interface.
    phase : phase of the scene, optional
    """

    where: str
    body: str = ""
    coating: str = UNCOATED
    outer: Medium = None
    inner: Medium = None
    finish: Finish = POLISHED
    begins_behind: bool = False
    thin_lens_power_per_mm: float | None = None
    phase: Phase | None = None

    @property
    def name(self) -> str:
        """Name in the ledger, without that of its coating."""
        return self.body.removeprefix("coating of ")


class InterfaceKind(NamedTuple):
    """Kind and parameters of one interface of a scene.

    Attributes
    ----------
    where : str
        Path in the scene file.
    kind : int
        Number in `tables.KINDS`.
    parameters : (n, wavelengths) float64, or rows of numbers
    pieces : int
        Pieces of a coating's table.
    error : float
        Error of its interpolation.
    """

    where: str
    kind: int
    parameters: Sequence[Sequence[float]] | NDArray[np.float64] = ()
    pieces: int = 0
    error: float = 0.0


@by_address
class InterfaceTables(NamedTuple):
    """Interfaces of each region.

    Attributes
    ----------
    lens : Interfaces
        One row per refracting surface.
    mla : Interfaces
        `CURVED_ROW` and `FLAT_ROW`.
    objects : Interfaces
        One row per target and medium that may be on its outside, see `tables.body_row`; rows of opaque targets are not
        used.
    cover : Interfaces
        Front and rear face of the sensor's cover; none without one.
    """

    lens: Interfaces
    mla: Interfaces
    objects: Interfaces
    cover: Interfaces


def lens_faces(scene: Scene) -> list[Face]:
    """Return the refracting surfaces of the lens.

    Coating layers are listed from air to glass; between glasses, from object to sensor.
    """
    lens = scene.camera.lens
    faces = []
    for i, (before, surface) in enumerate(zip(lens.media, lens.surfaces, strict=False)):
        behind = surface.medium is None and before is not None
        outer, inner = (surface.medium, before) if behind else (before, surface.medium)
        if not lens.is_pure_stop(i):
            names = f"camera.lens.surfaces[{i}]", f"coating of lens surface {i}", surface.coating
            power = surface.thin_lens_power_per_mm if surface.paraxial else None
            faces.append(Face(*names, outer, inner, surface.finish, behind, power, surface.phase))
    return faces


def array_faces(scene: Scene) -> list[Face]:
    """Return the curved and the flat face of the array, bare without an array."""
    mla = scene.camera.mla
    where = [f"camera.mla, its {side} face" for side in ("curved", "flat")]
    if mla is None:
        return [Face(each) for each in where]
    names = mla.curved_coating, mla.flat_coating
    bodies = [f"coating of the mla's {side} face" for side in ("curved", "flat")]
    finishes, phases = (mla.curved_finish, mla.flat_finish), (mla.curved_phase, mla.flat_phase)
    faces, outside = zip(where, bodies, names, finishes, phases, strict=True), scene.camera.medium_behind_lens
    return [
        Face(place, body, name, outside, mla.medium, finish, phase=phase) for place, body, name, finish, phase in faces
    ]


def cover_faces(scene: Scene) -> list[Face]:
    """Return the faces of the sensor's cover, starting towards the lens; none without a cover."""
    cover = scene.camera.sensor.cover
    if cover is None:
        return []
    return [
        Face(f"camera.sensor.cover, its {side} face", f"coating of the cover's {side} face", cover.coating,
             scene.camera.medium_behind_lens, cover.medium)
        for side in ("front", "rear")
    ]  # fmt: skip


def body_faces(scene: Scene, medium: int = AIR) -> list[Face]:
    """Return the surfaces of the targets with a given medium of object space on their outside.

    They are bare for opaque targets, and if the medium is neither that around bodies nor another body's.
    """
    faces, known = [], MediumList.of(scene)
    surroundings = known.media[known.before_lens]
    outer = surroundings if medium == AIR else known.media[medium]
    is_other = outer != surroundings
    bodies = [(i, target.refractor.medium) for i, target in enumerate(scene.targets) if target.refractor is not None]
    for i, target in enumerate(scene.targets):
        glass = target.refractor
        coating, inner, rough = UNCOATED, None, POLISHED
        if glass is not None:
            coating, inner, rough = glass.coating, glass.medium, glass.finish
        if is_other and outer not in [medium for other, medium in bodies if other != i]:
            coating, rough = UNCOATED, POLISHED
        body = f"coating of {target.name or f'targets[{i}]'}"
        faces.append(Face(f"targets[{i}]", body, coating, outer, inner, rough))
    return faces


def coatings_in_book(scene: Scene) -> list[str]:
    """Return the ledger's names of light lost at faces.

    One per coated face or body, that of the polariser, and two per face with a phase.
    """
    faces = (*lens_faces(scene), *array_faces(scene), *body_faces(scene), *cover_faces(scene))
    polariser = [POLARISER] if scene.camera.polariser_deg is not None else []
    orders = [name for face in faces if face.phase is not None for name in lost_orders(face.name)]
    return [*(face.body for face in faces if face.coating != UNCOATED), *polariser, *orders]


def refused_in_order(scene: Scene) -> str | None:
    """Describe the first surface that the sequential engine cannot trace; None if it can trace all."""
    array = array_faces(scene) if scene.camera.mla is not None else ()
    faces = (*lens_faces(scene), *array, *cover_faces(scene))
    wavelengths_nm = Lines.of(scene).wavelengths_nm
    for face in faces:
        kind = _kind_of(scene, face, wavelengths_nm)
        if kind >= ROUGH:
            return f"{face.where} is {KINDS[kind]}"
        if face.phase is not None and has_several_orders(face.phase):
            return f"{face.where} has a phase with several orders"
    return None


def interface_tables(scene: Scene, wavelengths_nm: tuple[float, ...], book: Book | None = None) -> InterfaceTables:
    """Return the interfaces of lens, array, object space and cover.

    Parameters
    ----------
    scene : Scene
    wavelengths_nm : tuple of float
    book : Book, optional
        For light absorbed in coatings; needed to trace packets.

    Raises
    ------
    SceneError, FileError
        A coating cannot be tabulated.
    """
    slots = book.coatings if book is not None else {}
    faces = faces_of_regions(scene)
    return InterfaceTables(
        *(
            _table(
                _finishes(scene, its, wavelengths_nm),
                [slots.get(face.body, NO_SLOT) for face in its],
                len(wavelengths_nm),
            )._replace(
                phases=phase_faces(
                    [face.phase for face in its],
                    [(face.outer, face.inner) for face in its],
                    [face.name for face in its],
                    wavelengths_nm,
                    slots,
                )
            )
            for its in faces
        )
    )


def coating_errors(scene: Scene) -> dict[str, float]:
    """Return the largest interpolation error of each coating in use, by name."""
    errors: dict[str, float] = {}
    wavelengths_nm = Lines.of(scene).wavelengths_nm
    for faces in faces_of_regions(scene):
        coated = [face for face in faces if face.coating != UNCOATED]
        for face, finish in zip(coated, _finishes(scene, coated, wavelengths_nm), strict=True):
            errors[face.coating] = max(errors.get(face.coating, 0.0), finish.error)
    return errors


def coating_lines(scene: Scene) -> list[str]:
    """Describe the coatings of a solved scene, one line per face: reflectance and, if absorbing, transmittance.

    Shares are for the primary wavelength, from the medium of lower index and by the angle there.
    """
    wavelengths_nm, colour = _shown_nm(scene)
    mla = array_faces(scene) if scene.camera.mla is not None else []
    lines, used = [], set()
    for face in (*lens_faces(scene), *mla, *body_faces(scene), *cover_faces(scene)):
        if face.coating == UNCOATED:
            continue
        finish = _kind_and_parameters(scene, face, wavelengths_nm)
        used.add(face.coating)
        said = f"reflects {_by_angle(finish, FROM_THIN, colour)}"
        if finish.kind == ABSORBING:
            said += f", passes {_by_angle(finish, PASSED, colour)}"
        error = f"tabulated to {finish.error:.0e}" if finish.error > 0.0 else "the same at every angle"
        lines.append(f"{face.body:<34}{face.coating}: {said}; {error}")
    unused = [name for name in scene.all_coatings if name not in used]
    return [*lines, *(f"Note: coatings.{name}: no surface has this coating" for name in unused)]


def _by_angle(finish: InterfaceKind, quantity: int, colour: int) -> str:
    """Describe a quantity of a coating's table (`optics.share_table`) at some angles."""
    values, first = np.asarray(finish.parameters), quantity * TERMS * finish.pieces
    shown = [looked_up(values, first, finish.pieces, colour, np.sqrt(np.cos(np.radians(a)))) for a in _SHOWN_DEG]
    return ", ".join(f"{100.0 * share:.3g} % at {a:g}" for share, a in zip(shown, _SHOWN_DEG, strict=True)) + " degrees"


def _shown_nm(scene: Scene) -> tuple[tuple[float, ...], int]:
    """Return the wavelengths to describe faces, and the number of the primary one."""
    # With bands, all wavelengths but the primary one are random.
    wavelengths_nm = scene.transport.wavelengths_nm if scene.camera.sensor.bands is None else (scene.primary_nm,)
    return wavelengths_nm, wavelengths_nm.index(scene.primary_nm)


def finish_lines(scene: Scene) -> list[str]:
    """Describe the rough faces of a solved scene, one line each; for diffuse ones, the reflectance from each side."""
    wavelengths_nm, colour = _shown_nm(scene)
    mla = array_faces(scene) if scene.camera.mla is not None else []
    lines = []
    for face in (*lens_faces(scene), *mla, *body_faces(scene)):
        if face.finish == POLISHED:
            continue
        kind, name = _kind_of(scene, face, wavelengths_nm), face.name
        said = face.finish.in_words()
        if kind == BARE:
            said += "; traced as polished"
        elif kind == DIFFUSE:
            thin, dense = (row[colour] for row in _kind_and_parameters(scene, face, wavelengths_nm).parameters)
            said += (
                f": reflects {100.0 * thin:.3g} % of diffuse light from the thinner side, {100.0 * dense:.3g} % from "
            )
            said += "the denser"
        lines.append(f"{'finish of ' + name:<34}{said}")
    return lines


def faces_of_regions(scene: Scene) -> tuple[list[Face], list[Face], list[Face], list[Face]]:
    """Return the faces of lens, array, object space and sensor cover, in the order of their rows."""
    by_medium = [body_faces(scene, medium) for medium in range(len(MediumList.of(scene).media))]
    bodies = [faces[i] for i in range(len(scene.targets)) for faces in by_medium]
    return lens_faces(scene), array_faces(scene), bodies, cover_faces(scene)


def _finishes(scene: Scene, faces: list[Face], wavelengths_nm: tuple[float, ...]) -> list[InterfaceKind]:
    return [_kind_and_parameters(scene, face, wavelengths_nm) for face in faces]


def _kind_of(scene: Scene, face: Face, wavelengths_nm: Sequence[float]) -> int:
    """Return the number of a face's kind."""
    if face.thin_lens_power_per_mm is not None:
        return THIN_LENS
    if face.finish.is_rough:
        kind = KINDS.index(face.finish.kind)
        # Facets between equal indices do nothing; a diffuse face still scatters transmitted light.
        matched = all(n_outer == n_inner for n_outer, n_inner in _indices(face, wavelengths_nm))
        return BARE if kind == GROUND and matched else kind
    if face.coating == UNCOATED:
        return BARE
    if scene.transport.polarisation:
        # Absorption of polarised packets in layers depends on their state, see `tables.polarisation`.
        return COATED
    return ABSORBING if absorbs(scene, face.coating, wavelengths_nm) else COATED


def _kind_and_parameters(scene: Scene, face: Face, wavelengths_nm: tuple[float, ...]) -> InterfaceKind:
    """Return kind and parameters of a face."""
    kind = _kind_of(scene, face, wavelengths_nm)
    if kind in (COATED, ABSORBING):
        table = coating_table(scene, face.coating, face.outer, face.inner, wavelengths_nm)
        return InterfaceKind(face.where, kind, table.values, table.pieces, table.error)
    return InterfaceKind(face.where, kind, _parameters(face, kind, wavelengths_nm))


def _parameters(face: Face, kind: int, wavelengths_nm: tuple[float, ...]) -> list[list[float]]:
    """Return the parameters of a face without a coating, (n, wavelengths)."""
    if kind == THIN_LENS:
        return [[face.thin_lens_power_per_mm or 0.0] * len(wavelengths_nm)]
    if kind == DIFFUSE:
        sides = [sorted(pair) for pair in _indices(face, wavelengths_nm)]
        return [
            [diffuse_reflectance(thin, dense) for thin, dense in sides],
            [diffuse_reflectance(dense, thin) for thin, dense in sides],
        ]
    if kind == GROUND:
        return [[face.finish.roughness or 0.0] * len(wavelengths_nm)]
    return []


def _indices(face: Face, wavelengths_nm: Sequence[float]) -> list[tuple[float, float]]:
    """Return the refractive indices on both sides of a face, for each wavelength."""
    return [(refractive_index(face.outer, w), refractive_index(face.inner, w)) for w in wavelengths_nm]


def _table(finishes: list[InterfaceKind], slots: list[int], colours: int) -> Interfaces:
    """Return the table of interfaces for kernels."""
    rows = np.zeros(len(finishes), INTERFACE)
    rows["kind"] = [finish.kind for finish in finishes]
    rows["pieces"] = [finish.pieces for finish in finishes]
    rows["slot"] = slots
    rows["first"] = np.cumsum([0, *(len(finish.parameters) for finish in finishes[:-1])])[: len(finishes)]
    parameters = [np.reshape(finish.parameters, (-1, colours)) for finish in finishes if len(finish.parameters)]
    return Interfaces(
        rows=rows,
        parameters=np.concatenate([np.zeros((0, colours)), *parameters]),
        coated=bool((rows["kind"] != BARE).any()),
        rough=bool((rows["kind"] >= ROUGH).any()),
        thin=bool((rows["kind"] == THIN_LENS).any()),
    )
