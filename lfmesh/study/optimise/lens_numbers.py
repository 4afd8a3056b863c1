"""Numbers of a solved lens that determine its rays, as one vector for differentiation.

Rays depend on a design's variables only through these numbers: shapes, phases, positions and indices of the surfaces,
gradients of the glass behind them, the stop, the object and the image plane.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.analysis.analysis import FIELDS, used_height_mm
from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.lens.main_order import lens_phases, refuse_several_orders
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import Scene
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.camera.phase import ZonedPhase
from lfmesh.scene.first_order.paraxial import Paraxial
from lfmesh.scene.first_order.solve import focus_wished_mm, image_plane_mm
from lfmesh.study.optimise.gradient_rays import GradientForm, gradient_form, gradient_numbers
from lfmesh.study.optimise.jet import Jet
from lfmesh.study.optimise.phase_terms import phase_terms

Array = NDArray[np.float64]


class SurfaceNumbers(NamedTuple):
    """Numbers of one surface.

    Attributes
    ----------
    curvature, conic, thin_power : Jet
        Curvature at the vertex, 1/mm; conic constant; power of an ideal thin lens, 1/mm.
    pose : Jet
        (3, 4): rotation and position of its frame, with the vertex as origin.
    terms : Jet
        Coefficients of the powers of r added to the conic.
    phase_powers, phase_distances : Jet
        Terms of the phase of a diffractive surface, see `PhaseTerms`.
    gradient : Jet
        (wavelengths, numbers) of the gradient-index glass behind it; (wavelengths, 0) for homogeneous media.
    """

    curvature: Jet
    conic: Jet
    thin_power: Jet
    pose: Jet
    terms: Jet
    phase_powers: Jet
    phase_distances: Jet
    gradient: Jet


class LensNumbers(NamedTuple):
    """Numbers of a lens, its object points and its image plane.

    Attributes
    ----------
    surfaces : list of SurfaceNumbers
    indices : Jet
        (wavelengths, surfaces + 1): before the first surface and after each; of gradient-index glass, at the vertex.
    stop_radius, vergence, image_z : Jet
        Radius of the stop, mm; reciprocal of the object distance, 1/mm; image plane, mm.
    slopes, heights : Jet
        (fields,): slopes of the object points, see `LensRays.starts`; paraxial image heights, mm.
    """

    surfaces: list[SurfaceNumbers]
    indices: Jet
    stop_radius: Jet
    vergence: Jet
    image_z: Jet
    slopes: Jet
    heights: Jet


@dataclass(frozen=True)
class RayLayout:
    """Properties of a lens that stay fixed while its numbers vary, and its rays.

    Attributes
    ----------
    powers : tuple of tuple of int
        Powers of r added to the conic of each surface.
    phases : tuple of (int, int)
        Numbers of powers and of distances in the phase of each surface, see `PhaseTerms`.
    gradients : tuple of (GradientForm or None)
        Form of the gradient behind each surface.
    stop : int
        Number of the stop surface.
    pure_stop : bool
        True if the stop is not an interface.
    waves_nm : tuple of float
        The primary one in the middle.
    fields : tuple of float
        Fractions of the largest image height.
    object_mm : float or None
        Distance of the object plane; None: as focused.
    height_mm : float or None
        Largest image height; None: half the diagonal of the used part of sensor and array.
    """

    powers: tuple[tuple[int, ...], ...]
    phases: tuple[tuple[int, int], ...]
    gradients: tuple[GradientForm | None, ...]
    stop: int
    pure_stop: bool
    waves_nm: tuple[float, ...]
    fields: tuple[float, ...] = FIELDS
    object_mm: float | None = None
    height_mm: float | None = None

    @property
    def turns_mm(self) -> Array:
        """(wavelengths,): λ/2π, the change of a direction cosine by a gradient of 1 rad/mm."""
        return np.array(self.waves_nm) * 1e-6 / (2.0 * math.pi)

    def numbers_of(self, scene: Scene) -> Array:
        """Return the numbers of a solved scene, (n,), in the order of `opened`.

        Raises
        ------
        LfmeshError
            There is no image of the object plane, or the lens has another layout.
        """
        camera, primary = scene.camera, scene.primary_nm
        lens, paraxial = camera.lens, Paraxial.of(camera.lens, primary)
        image = image_plane_mm(camera, primary)
        object_mm = self.object_mm or focus_wished_mm(camera, primary) or paraxial.object_mm(image)
        if not object_mm > 0.0:
            raise LfmeshError(
                f"the plane in focus lies {object_mm:.6g} mm before the lens: give object_mm in [rays], above 0 or inf"
            )
        phases = [phase_terms(surface) for surface in lens.surfaces]
        counts = tuple(phase.counts for phase in phases)
        layout = powers_of(lens), counts, gradients_of(lens, self.waves_nm), lens.stop_index
        if layout != (self.powers, self.phases, self.gradients, self.stop):
            raise LfmeshError("the surfaces have other terms, or another stop, than at the start")
        heights = (self.height_mm or used_height_mm(scene)) * np.array(self.fields)
        image_z = paraxial.length_mm + image
        middle = Paraxial.of(lens, self.waves_nm[len(self.waves_nm) // 2])
        slopes = heights / middle.chief_scale_mm(object_mm, image)
        per_surface = [
            number
            for k, surface in enumerate(lens.surfaces)
            for number in (
                *(surface.curvature_per_mm, surface.vertex_conic, surface.thin_lens_power_per_mm),
                *_frame_of(lens, k).ravel(),
                *(coefficient for _, coefficient in surface.powers_mm),
                *phases[k].powers,
                *phases[k].distances.ravel(),
                *gradient_numbers(surface, self.waves_nm).ravel(),
            )
        ]
        indices = [refractive_index(medium, wave) for wave in self.waves_nm for medium in lens.media]
        stop = lens.surfaces[self.stop].semi_diameter_mm or math.nan
        return np.array([*per_surface, *indices, stop, 1.0 / object_mm, image_z, *slopes, *heights])

    def opened(self, numbers: Jet) -> LensNumbers:
        """Return the numbers by their meaning.

        Parameters
        ----------
        numbers : Jet
            (n,), from `numbers_of`.
        """
        at = 0

        def taken(*shape: int) -> Jet:
            nonlocal at
            first, at = at, at + math.prod(shape)
            part = numbers.picked(slice(first, at))
            return Jet(part.value.reshape(shape), part.slope.reshape(*shape, numbers.slope.shape[-1]))

        surfaces, waves = [], len(self.waves_nm)
        for terms, (powers, distances), form in zip(self.powers, self.phases, self.gradients, strict=True):
            shape = taken(), taken(), taken(), taken(3, 4), taken(len(terms))
            phase, count = (taken(powers), taken(distances, 2)), form.numbers + form.material if form else 0
            surfaces.append(SurfaceNumbers(*shape, *phase, taken(waves, count)))
        indices = taken(waves, len(self.powers) + 1)
        fields = len(self.fields)
        return LensNumbers(surfaces, indices, taken(), taken(), taken(), taken(fields), taken(fields))


def layout_of(scene: Scene, waves_nm: tuple[float, ...], object_mm: float | None, height_mm: float | None) -> RayLayout:
    """Return the layout of a solved scene.

    Parameters
    ----------
    scene : Scene
    waves_nm, object_mm, height_mm
        As for `RayLayout`.

    Raises
    ------
    LfmeshError
        A surface is a mesh or not of revolution, or a phase has several orders.
    """
    lens = scene.camera.lens
    if lens.has_meshes:
        raise LfmeshError("the lens has surfaces that are meshes: terms of rays need surfaces with formulas")
    if (number := lens.number_off_revolution) is not None:
        key, followed = lens.surfaces[number].asymmetric_key, lens.kinds_followed(number)
        raise LfmeshError(f"camera.lens.surfaces[{number}].{key}: terms of rays are for {followed}")
    for i, surface in enumerate(lens.surfaces):
        if isinstance(surface.phase, ZonedPhase):
            raise LfmeshError(
                f'camera.lens.surfaces[{i}].phase.kind = "zones": terms of rays are for phases of one formula only; '
                "give another kind"
            )
    refuse_several_orders(lens_phases(scene))
    stop, phases = lens.stop_index or 0, tuple(phase_terms(surface).counts for surface in lens.surfaces)
    return RayLayout(
        powers_of(lens), phases, gradients_of(lens, waves_nm), stop, lens.is_pure_stop(stop), waves_nm,
        object_mm=object_mm, height_mm=height_mm,
    )  # fmt: skip


def powers_of(lens: Lens) -> tuple[tuple[int, ...], ...]:
    """Return the powers of r added to the conic of each surface."""
    return tuple(tuple(power for power, _ in surface.powers_mm) for surface in lens.surfaces)


def gradients_of(lens: Lens, waves_nm: tuple[float, ...]) -> tuple[GradientForm | None, ...]:
    """Return the form of the gradient behind each surface."""
    return tuple(gradient_form(surface, waves_nm[len(waves_nm) // 2]) for surface in lens.surfaces)


def _frame_of(lens: Lens, number: int) -> Array:
    """Return the frame of a surface, (3, 4), with its vertex as origin, in the camera frame."""
    vertex = np.column_stack([np.eye(3), [0.0, 0.0, lens.vertices_mm[number]]])
    return frame.compose(pose_of(lens, number), vertex)
