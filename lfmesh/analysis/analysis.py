"""`lf.analyse`: all figures of the lens sheet, with their definitions."""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.analysis.diffraction import FieldWaves, diffraction_limit, field_waves
from lfmesh.analysis.field_curves import FieldCurves, field_curves, paraxial_scale, zone_foci
from lfmesh.analysis.light_field import LightFieldAnalysis, analyse_light_field
from lfmesh.analysis.spots import Spot
from lfmesh.errors import LfmeshError
from lfmesh.geometry.lens.main_order import orders_in_words, phases_of, with_main_orders
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.notebook import Say, Shown, announced
from lfmesh.scene import FirstOrder, Scene, Surface
from lfmesh.scene.distance import length_in_words
from lfmesh.scene.first_order.compute import airy_disk_mm
from lfmesh.scene.first_order.relay import relay_of, seen_size_mm
from lfmesh.scene.literals import literal
from lfmesh.transport.build import build
from lfmesh.transport.world import World
from lfmesh.waves.bundle import LensRays, pupil_grid

Array = NDArray[np.float64]

FIELDS = (0.0, 0.7, 1.0)
"""Fields, as fractions of the largest image height."""

LINES_NM = (486.1327, 587.5618, 656.2725)
"""Fraunhofer's lines F, d and C, for scenes with a single wavelength."""

ACROSS = 64
"""Rays across the stop's diameter."""

FAN = 65
ZONES = 20
FREQUENCIES = 61

REFOCUSED = 1e-6
"""Relative difference of distances below which the object lies in the plane in focus; solving leaves less."""

FINEST_MTF = 0.5
"""Highest frequency of the geometric MTF, over the diffraction cut-off."""

DEFINITIONS = (
    "image plane: the array's apexes, the plane that a focused camera's lenslets image, or the sensor; not refocused",
    "fields: chief rays at fractions of the paraxial image height, meridional plane; objects below the axis",
    "rays: square grid in the stop (real ray aiming), equal areas, weighted by Fresnel's transmittance",
    "spots: all wavelengths, equal weights; rms about the centroid; GEO: largest distance from the primary chief ray",
    "fans: relative to the field's primary chief ray or, without one, the mean; pupil coordinate in the stop",
    "longitudinal aberration: axial crossings of an axial point's rays; + behind the image plane",
    "foci: rays 0.001 stop radii from the chief ray (Coddington's, by differences); + behind the image plane",
    "distortion: chief ray relative to its paraxial height, primary wavelength",
    "lateral colour: chief rays relative to the primary wavelength's",
    "illumination: irradiance of a Lambertian plane's image over that on the axis, primary wavelength",
    "pass: share of the stop's points, unweighted; Airy radius (circle): 1.22 λ N, primary wavelength, working N",
    "path differences: + ahead of the sphere around the primary chief ray's image, relative to each colour's chief ray",
    "wavefront: primary wavelength; rms without the mean, tilt included; Strehl ratio from it, weighted as spots",
    "point spread: by diffraction, all wavelengths, relative to the peak of the same light in phase; circle: Airy",
    "MTF: by waves (thick), and by rays, the modulus of the spot's transform (thin); all wavelengths, equal weights",
    "diffraction limit (dotted): a perfect round pupil on the axis at the working f-number, all wavelengths",
)
"""Definitions of the figures, for comparison with other programs."""


@dataclass(frozen=True)
class Fan:
    """Transverse ray fans of one field at one wavelength, from its spot's reference.

    Attributes
    ----------
    pupil : (n,) float64
        Pupil coordinate, -1 to 1 stop radii.
    tangential_mm : (n,) float64
        Deviation of meridional rays along y; NaN where blocked.
    sagittal_mm : (n,) float64
        Deviation of rays through the stop's x axis along x; NaN where blocked.
    """

    pupil: Array
    tangential_mm: Array
    sagittal_mm: Array


@dataclass(frozen=True)
class LensAnalysis(Shown):
    """Analysis of a lens at its image plane.

    Attributes
    ----------
    name : str
    first_order : FirstOrder
    object_mm : float
        Object distance before the first vertex; inf: parallel light.
    image_z_mm : float
        Image plane, camera frame.
    wavelengths_nm : tuple of float
        Ascending, with the primary one in the middle.
    heights_mm : (fields,) float64
        Paraxial image heights.
    spots : list of Spot
        One per field.
    fans : list of list of Fan
        [field][wavelength].
    curves : FieldCurves
    zones : (m,) float64
    zone_foci_mm : (wavelengths, m) float64
        Longitudinal aberration of an axial point, over the zones of the stop.
    frequencies_per_mm : (f,) float64
    mtf : (fields, 2, f) float64
        Tangential, sagittal.
    diffraction_limit : (f,) float64
        MTF of a perfect lens on the axis.
    rays : LensRays
        Rays from the object plane through the lens.
    airy_radius_mm : float
        1.22 λ N at the primary wavelength.
    light_field : LightFieldAnalysis or None
        None without a microlens array.
    no_light_field : str
        Reason if a camera with an array has none.
    orders : tuple of str
        The order in which rays are followed, in words, for each diffractive face.
    """

    name: str
    first_order: FirstOrder
    object_mm: float
    image_z_mm: float
    wavelengths_nm: tuple[float, ...]
    heights_mm: Array
    spots: list[Spot]
    fans: list[list[Fan]]
    curves: FieldCurves
    zones: Array
    zone_foci_mm: Array
    frequencies_per_mm: Array
    mtf: Array
    diffraction_limit: Array
    rays: LensRays = field(repr=False)
    airy_radius_mm: float
    light_field: LightFieldAnalysis | None = None
    no_light_field: str = ""
    orders: tuple[str, ...] = ()

    @cached_property
    def waves(self) -> list[FieldWaves | str]:
        """Diffraction image per field, or why there is none; computed on first access."""
        return [_waves(self.rays, spot, self.wavelengths_nm) for spot in self.spots]

    @property
    def primary_nm(self) -> float:
        """The middle wavelength."""
        return self.wavelengths_nm[len(self.wavelengths_nm) // 2]

    @property
    def focus_in_words(self) -> str:
        """Distance that the camera is focused at and the object's defocus, in words; "" if the object is in focus."""
        focused = self.first_order.object_distance_mm
        if self.object_mm == focused or math.isclose(self.object_mm, focused, rel_tol=REFOCUSED):
            return ""
        camera = solved_camera(self.rays.world.scene)
        image = camera.paraxial.image_mm(self.object_mm)
        words = f"not refocused: the camera is focused at {length_in_words(focused)}"
        if not (0.0 < image < math.inf):
            return f"{words}, and the object has no real image"
        beyond = image + camera.paraxial.length_mm - self.image_z_mm
        side = "behind" if beyond > 0.0 else "before"
        origin = "" if camera.scene.camera.focus_from == "first_vertex" else ', camera.focus_from = "first_vertex"'
        return (
            f"{words}, and the object's paraxial image lies {abs(beyond):.4g} mm {side} the image plane; to "
            f"refocus, give camera.focus_mm = {literal(self.object_mm)}{origin} and omit the distances"
        )

    def __repr__(self) -> str:
        facts = self.first_order
        spots = ", ".join(f"{1e3 * spot.rms_mm:.3g}" for spot in self.spots)
        lens = f"f = {facts.efl_mm:.5g} mm, f/{facts.working_f_number:.3g}"
        return f"<LensAnalysis: {self.name}, {lens}, spots rms {spots} µm>"

    def lines(self) -> list[str]:
        """Return the key figures for a terminal, one line each.

        Returns
        -------
        list of str
        """
        facts = self.first_order
        at = "infinity" if math.isinf(self.object_mm) else f"{self.object_mm:.6g} mm"
        lines = [
            f"f = {facts.efl_mm:.4f} mm, working f/{facts.working_f_number:.3f}, object at {at}, "
            f"image plane z = {self.image_z_mm:z.4f} mm",
            *filter(None, [self.focus_in_words]),
            *self.orders,
            f"Airy radius {1e3 * self.airy_radius_mm:.3f} µm at {self.primary_nm:g} nm; "
            f"wavelengths {', '.join(f'{w:g}' for w in self.wavelengths_nm)} nm",
            f"{'field/mm':>9}{'chief/mm':>11}{'rms/µm':>10}{'GEO/µm':>10}{'passed':>9}"
            f"{'T-focus/mm':>12}{'S-focus/mm':>12}{'dist/%':>9}{'light':>8}",
        ]
        c, middle = self.curves, len(self.wavelengths_nm) // 2
        for height, spot in zip(self.heights_mm, self.spots, strict=True):
            t, s, d, light = (
                float(np.interp(height, c.height_mm, curve))
                for curve in (c.tangential_mm[middle], c.sagittal_mm[middle], 100.0 * c.distortion, c.illumination)
            )
            lines.append(
                f"{height:9.3f}{spot.chief_mm[1]:z11.4f}{1e3 * spot.rms_mm:10.3f}{1e3 * spot.geo_mm:10.3f}"
                f"{spot.passed:9.1%}{t:z12.4f}{s:z12.4f}{d:z9.3f}{light:8.1%}"
            )
        lines += [
            f"{height:9.3f}  no chief ray: it is blocked by {spot.chief_blocked_by}; spot and fans are relative to the "
            "mean of the other rays"
            for height, spot in zip(self.heights_mm, self.spots, strict=True)
            if not spot.has_chief
        ]
        lines.append(f"{'field/mm':>9}{'rms/waves':>11}{'P-V/waves':>11}{'Strehl':>9}")
        for height, waves in zip(self.heights_mm, self.waves, strict=True):
            if isinstance(waves, str):
                lines.append(f"{height:9.3f}  no waves: {waves}")
            else:
                front = waves.wavefront
                lines.append(f"{height:9.3f}{front.rms_waves:11.4f}{front.pv_waves:11.4f}{front.strehl:9.4f}")
        if self.light_field is not None:
            lines += self.light_field.lines()
        if self.no_light_field:
            lines.append(f"no figures of the light field: {self.no_light_field}")
        return lines

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def as_dict(self) -> dict[str, Any]:
        """Return the key figures as plain numbers.

        Returns
        -------
        dict
        """
        return {
            "name": self.name,
            "object_mm": self.object_mm,
            "image_z_mm": self.image_z_mm,
            "wavelengths_nm": list(self.wavelengths_nm),
            "efl_mm": self.first_order.efl_mm,
            "working_f_number": self.first_order.working_f_number,
            "airy_radius_mm": self.airy_radius_mm,
            "fields": [
                {
                    "height_mm": float(height),
                    "chief_mm": float(spot.chief_mm[1]),
                    "rms_mm": spot.rms_mm,
                    "rms_chief_mm": spot.rms_chief_mm,
                    "geo_mm": spot.geo_mm,
                    "passed": spot.passed,
                }
                | _wave_figures(waves)
                for height, spot, waves in zip(self.heights_mm, self.spots, self.waves, strict=True)
            ],
            "definitions": list(DEFINITIONS),
            "orders": list(self.orders),
            "light_field": None if self.light_field is None else self.light_field.as_dict(),
        }


def analyse(
    scene: Scene,
    *,
    object_mm: float | None = None,
    height_mm: float | None = None,
    wavelengths_nm: tuple[float, ...] | None = None,
    across: int = ACROSS,
    progress: Say | bool | None = None,
) -> LensAnalysis:
    """Analyse the main lens of a scene at its image plane, as a lens sheet shows it.

    At a diffractive face with several orders, rays are followed in the main one; the analysis says so.

    Parameters
    ----------
    scene : Scene
        Element poses count; targets and lights do not.
    object_mm : float, optional
        Distance before the first vertex; inf for parallel light. Default: the plane in focus.
    height_mm : float, optional
        Largest image height. Default: half the diagonal of the used part of sensor and array.
    wavelengths_nm : tuple of float, optional
        An odd number, the primary one in the middle. Default: the scene's (without the shortest if even in number), or
        F, d and C if it has one and the lens glass.
    across : int
        Rays across the stop's diameter.
    progress : callable or bool, optional
        Called with the progress in words. True shows it, False nothing. Default: it is shown at a terminal or in a
        notebook after two seconds.

    Returns
    -------
    LensAnalysis

    Raises
    ------
    LfmeshError
        A surface is a mesh or not of revolution, no ray passes the lens, or a value is out of range.
    """
    camera = solved_camera(scene)
    facts = camera.report
    if (number := camera.scene.camera.lens.number_off_revolution) is not None:
        lens = camera.scene.camera.lens
        key, followed = lens.surfaces[number].asymmetric_key, lens.kinds_followed(number)
        raise LfmeshError(
            f"camera.lens.surfaces[{number}].{key}: the lens sheet is for {followed}. Trace rays or render instead"
        )
    object_mm = facts.object_distance_mm if object_mm is None else float(object_mm)
    waves = wavelengths_of(scene, wavelengths_nm)
    if not 4 <= across <= 1000:
        raise LfmeshError(f"across = {across}: must be from 4 to 1000 rays")
    height = used_height_mm(camera.scene) if height_mm is None else float(height_mm)
    if not 0.0 < height < math.inf:
        raise LfmeshError(f"height_mm = {height}: must be above 0 and finite")
    with announced(progress) as say:
        say("lens: building")
        rays = LensRays(build(with_main_orders(camera.scene.camera_alone())), object_mm, facts.image_z_mm)
        return _analysed(scene, rays, height, waves, across, say)


def _analysed(
    scene: Scene, rays: LensRays, height: float, waves: tuple[float, ...], across: int, say: Say
) -> LensAnalysis:
    """Return the analysis of a lens up to an image height, mm, with rays of some wavelengths."""
    camera, world, object_mm = solved_camera(scene), rays.world, rays.object_mm
    facts = camera.report
    heights = height * np.array(FIELDS)
    primary = waves[len(waves) // 2]
    slopes = heights / paraxial_scale(rays, primary)
    spots = []
    for number, slope in enumerate(slopes):
        say(f"lens: spot {number + 1} of {len(slopes)}")
        spots.append(_spot(rays, float(slope), waves, across))
    say("lens: cross-talk and photographs of the array")
    light_field, why_not = _light_field(world, object_mm, heights)
    say("lens: fans, foci and MTF")
    zones = (np.arange(ZONES) + 1.0) / ZONES
    cut_off = 1e6 / (primary * facts.working_f_number)
    frequencies = np.linspace(0.0, FINEST_MTF * cut_off, FREQUENCIES)
    return LensAnalysis(
        name=": ".join(dict.fromkeys(filter(None, (scene.title, world.scene.camera.lens.name)))) or "lens",
        first_order=facts,
        object_mm=object_mm,
        image_z_mm=facts.image_z_mm,
        wavelengths_nm=waves,
        heights_mm=heights,
        spots=spots,
        fans=[_fans(rays, spot, waves) for spot in spots],
        curves=field_curves(rays, waves, height),
        zones=zones,
        zone_foci_mm=zone_foci(rays, waves, zones),
        frequencies_per_mm=frequencies,
        mtf=np.array([[spot.mtf(frequencies, tangential=t) for t in (True, False)] for spot in spots]),
        diffraction_limit=diffraction_limit(frequencies, waves, facts.working_f_number),
        rays=rays,
        airy_radius_mm=0.5 * airy_disk_mm(primary, facts.working_f_number),
        light_field=light_field,
        no_light_field=why_not,
        orders=tuple(orders_in_words(phases_of(camera.scene))),
    )


def _waves(rays: LensRays, spot: Spot, wavelengths_nm: tuple[float, ...]) -> FieldWaves | str:
    """Return a field's diffraction image, or why there is none."""
    camera = solved_camera(rays.world.scene)
    try:
        return field_waves(rays, camera, spot.slope_y, wavelengths_nm, spot.reach_mm, np.linspace(-1.0, 1.0, FAN))
    except LfmeshError as error:
        return str(error)


def _wave_figures(waves: FieldWaves | str) -> dict[str, float | str | None]:
    """Return a wavefront's key figures, or why there are none."""
    if isinstance(waves, str):
        return {"rms_waves": None, "pv_waves": None, "strehl": None, "no_waves": waves}
    front = waves.wavefront
    return {"rms_waves": front.rms_waves, "pv_waves": front.pv_waves, "strehl": front.strehl}


def _light_field(world: World, object_mm: float, heights_mm: Array) -> tuple[LightFieldAnalysis | None, str]:
    """Return the light-field figures, or why an array has none."""
    if world.scene.camera.mla is None:
        return None, ""
    try:
        return analyse_light_field(world, object_mm, heights_mm), ""
    except LfmeshError as error:
        return None, str(error)


def wavelengths_of(scene: Scene, given: tuple[float, ...] | None) -> tuple[float, ...]:
    """Return the wavelengths of an analysis, in nm, ascending."""
    waves = tuple(sorted(scene.wavelengths_nm if given is None else map(float, given)))
    if given is None and len(waves) == 1 and any(map(_disperses, scene.camera.lens.surfaces)):
        waves = LINES_NM
    if len(waves) % 2 == 0:
        if given is not None:
            raise LfmeshError(f"wavelengths_nm = {given}: give an odd number, so that one is in the middle")
        waves = waves[1:]
    return waves


def _disperses(surface: Surface) -> bool:
    """Tell whether the index of the medium behind a surface depends on the wavelength."""
    if surface.gradient is None:
        return surface.glass is not None
    blue, _, red = map(surface.gradient.index_at, LINES_NM)
    return blue != red


def used_height_mm(scene: Scene) -> float:
    """Return half the diagonal of the image area shared by sensor and array."""
    return 0.5 * float(np.hypot(*seen_size_mm(scene.camera, relay_of(scene.camera, scene.primary_nm))))


def _spot(rays: LensRays, slope_y: float, waves: tuple[float, ...], across: int) -> Spot:
    grid = pupil_grid(across)
    bundles = [rays.bundle(slope_y, grid, wavelength) for wavelength in waves]
    chief = rays.chief(slope_y, waves[len(waves) // 2])
    passes = [bundle.passes for bundle in bundles]
    if not any(each.any() for each in passes):
        raise LfmeshError(
            f"no ray of the field with a slope of {slope_y:.4g} passes the lens; give a smaller height_mm"
        )
    places = np.concatenate([bundle.place[ok] for bundle, ok in zip(bundles, passes, strict=True)])
    reference = chief.place if chief.exists else places.mean(axis=0)
    return Spot(
        slope_y,
        chief.place,
        reference,
        places - reference,
        np.concatenate([bundle.weight[ok] for bundle, ok in zip(bundles, passes, strict=True)]),
        np.repeat(waves, [int(ok.sum()) for ok in passes]),
        float(np.mean(passes)),
        chief.blocked_by,
    )


def _fans(rays: LensRays, spot: Spot, waves: tuple[float, ...]) -> list[Fan]:
    along = np.linspace(-1.0, 1.0, FAN)
    none, reference = np.zeros(FAN), spot.reference_mm
    fans = []
    for wavelength in waves:
        tangential = rays.bundle(spot.slope_y, np.column_stack([none, along]), wavelength)
        sagittal = rays.bundle(spot.slope_y, np.column_stack([along, none]), wavelength)
        fans.append(Fan(along, tangential.place[:, 1] - reference[1], sagittal.place[:, 0] - reference[0]))
    return fans
