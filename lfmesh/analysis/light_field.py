"""Light field of a plenoptic camera: cross-talk between micro-images, and the MTF of photographs.

Cross-talk: uniform light fills the exit pupil at every point of the array round a lenslet. MTF: an object point's light
is binned into pixels and placed in the photograph as by `decode` and `refocus` (or `render_patches`); the spread is
averaged over all positions of the point relative to the lenslets.
"""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.analysis.array_rays import ArrayRays, Landed, even_points
from lfmesh.analysis.field_curves import paraxial_scale
from lfmesh.analysis.spots import half_contrast
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.photographs.depth import BORDER
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.lightfield.views.decode import sampling_of, view_count
from lfmesh.lightfield.views.focused import lenslet_blur_px
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene
from lfmesh.scene.first_order.solve import lenslet_focal_length_mm
from lfmesh.transport.world import World
from lfmesh.waves.bundle import LensRays

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

PLACES = 128
"""Places per lenslet at which light crosses the array."""

MOST_RINGS = 4
"""Largest number of rings of neighbours that are traced round a lenslet."""

CLOSER = 0.8
"""Pitches added to the reach of a lenslet's light when counting rings: rings begin nearer than their number."""

POINTS = 512
"""Positions of an object point relative to the lenslets."""

FREQUENCIES = 61

BINS = 128
"""Bins per lenslet pitch in a photograph."""

FAR = 1e4
"""Distance that stands for infinity where a finite scale is needed, in focal lengths."""

CANDIDATES = 5
"""Largest number of micro-images that may use a pixel."""

MOST_PATCHES = 25
"""Largest number of lenslets that see a point of the main image."""

SHARES = (1.5, 1.22, 1.0, 0.82, 0.67)
"""Planes for a focused plenoptic camera, as multiples of the shift at which lenslets are sharp."""

VIEWS = ("middle view", "edge view", "all views")
PIXELS = ("inner pixels", "outer pixels", "all pixels")

DEFINITIONS = (
    "cross-talk: uniform radiance fills the exit pupil; equal areas of the array and of the stop, weighted by "
    "Fresnel's transmittance of lens and array; refracted light only, primary wavelength",
    "cell: the area nearer to the landing point of its lenslet's chief ray than to any other's",
    "from others: share of the light in the lenslet's cell that met another lenslet; "
    "to others: share of the light that met the lenslet and lands outside its cell; "
    "accurate to about 0.1 percentage points or a tenth of the value",
    "fields: the lenslet nearest the paraxial height, towards a corner of the array, with all its neighbours",
    "photographs: a point on the axis at each distance, primary wavelength, stop and weights as above; "
    "landing points are binned into pixels",
    "MTF: modulus of the transform of the photograph's spread along +x, mean over all positions of the point relative "
    "to the lenslets; its frequencies are on the array, as in the middle view; no diffraction",
)

OF_VIEWS = (
    "views: pixels interpolated around the chief rays as decode does; the photograph is all views shifted by "
    "the ray model's shift for the distance, linearly between samples, and added; not divided by white",
    "middle view: at the pupil's middle (to its right if there is none); edge view: the outermost one on the right "
    "that lies wholly within the pupil",
)

OF_PATCHES = (
    "photograph: each pixel at its lenslet's apex and the shift times its distance from the chief ray, "
    "interpolated linearly, weighted as render_patches does; not divided by the sum of weights",
    "inner, outer pixels: inside and outside half the usable radius of the micro-images",
)


@dataclass(frozen=True)
class CrossTalk:
    """Cross-talk at one lenslet.

    Attributes
    ----------
    height_mm : float
        Distance of its apex from the axis.
    lenslet : tuple of int
        Column and row.
    from_others : float
        Fraction of the light in its cell that met another lenslet.
    to_others : float
        Fraction of the light through it that lands outside its cell.
    """

    height_mm: float
    lenslet: tuple[int, int]
    from_others: float
    to_others: float


@dataclass(frozen=True)
class PhotographMtf:
    """MTF of the photograph of one plane.

    Attributes
    ----------
    distance_mm : float
        Distance before the first vertex.
    shift_lenslets : float
        Shift of a point from view to view, in lenslets; positive nearer than the focus.
    mtf : (3, f) float64
        One curve for each of the light field's `parts`; NaN where there is none.
    """

    distance_mm: float
    shift_lenslets: float
    mtf: Array


@dataclass(frozen=True)
class LightFieldAnalysis:
    """Light-field figures of a plenoptic camera.

    Attributes
    ----------
    wavelength_nm : float
        Primary wavelength, for all figures here.
    crosstalk : list of CrossTalk
        One per field.
    frequencies_per_mm : (f,) float64
        Frequencies on the array.
    parts : tuple of str
        Names of the three curves of a photograph.
    photographs : list of PhotographMtf
        From the nearest plane to the farthest.
    definitions : tuple of str
    """

    wavelength_nm: float
    crosstalk: list[CrossTalk]
    frequencies_per_mm: Array
    parts: tuple[str, ...]
    photographs: list[PhotographMtf]
    definitions: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the key figures for a terminal, one line each."""
        lines = [f"cross-talk of micro-images at {self.wavelength_nm:g} nm"]
        lines.append(f"{'lenslet/mm':>11}{'from-others':>13}{'to-others':>11}")
        lines += [f"{c.height_mm:11.3f}{c.from_others:13.2%}{c.to_others:11.2%}" for c in self.crosstalk]
        lines.append("frequency of half contrast (MTF50) of photographs, line pairs per mm on the array")
        parts = "".join(f"{part.replace(' ', '-'):>14}" for part in self.parts)
        lines.append(f"{'plane/mm':>11}{'shift/p':>9}{parts}")
        for each in self.photographs:
            halves = (half_contrast(self.frequencies_per_mm, curve) for curve in each.mtf)
            far = "inf" if math.isinf(each.distance_mm) else f"{each.distance_mm:z.2f}"
            lines.append(f"{far:>11}{each.shift_lenslets:z9.2f}" + "".join(f"{half:14.3f}" for half in halves))
        return lines

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as plain numbers."""
        return {
            "wavelength_nm": self.wavelength_nm,
            "crosstalk": [asdict(each) for each in self.crosstalk],
            "frequencies_per_mm": self.frequencies_per_mm.tolist(),
            "parts": list(self.parts),
            "photographs": [asdict(each) | {"mtf": each.mtf.tolist()} for each in self.photographs],
            "definitions": list(self.definitions),
        }


def analyse_light_field(world: World, object_mm: float, heights_mm: Array) -> LightFieldAnalysis:
    """Analyse the light field of a camera with an array.

    Parameters
    ----------
    world : World
        World of the camera alone.
    object_mm : float
        Distance before the first vertex of the object plane for cross-talk.
    heights_mm : (fields,) float64
        Image heights of the fields.

    Raises
    ------
    LfmeshError
        The array cannot be decoded: it has cylindrical lenslets, or lenslets on both faces.
    """
    scene = world.scene
    model, facts = RayModel.of(scene), solved_camera(scene).report
    rays = ArrayRays(world, facts.lenslets_z_mm or 0.0)
    by_patches = bool(facts.focused)
    finest = abs(_sharp_shift_mm(scene, model)) if by_patches else model.lenslet_pitch_mm
    frequencies = np.linspace(0.0, 1.0 / finest, FREQUENCIES)
    photographs = []
    for distance in _distances_mm(scene, model, by_patches=by_patches):
        mtf = photograph_mtf(rays, distance, frequencies, by_patches=by_patches)
        photographs.append(PhotographMtf(distance, model.shift_mm(distance) / model.lenslet_pitch_mm, mtf))
    return LightFieldAnalysis(
        wavelength_nm=scene.primary_nm,
        crosstalk=[_crosstalk(rays, model, object_mm, float(height)) for height in heights_mm],
        frequencies_per_mm=frequencies,
        parts=PIXELS if by_patches else VIEWS,
        photographs=photographs,
        definitions=(*DEFINITIONS, *(OF_PATCHES if by_patches else OF_VIEWS)),
    )


def _distances_mm(scene: Scene, model: RayModel, *, by_patches: bool) -> list[float]:
    """Return the distances of five planes: focus, ends of the refocusing range, and midway between them by shift."""
    if by_patches:
        sharp = _sharp_shift_mm(scene, model)
        least = 0.5 * model.lenslet_pitch_mm / _held_px(model)
        found = [model.distance_mm(sharp * share) for share in SHARES if abs(sharp * share) > least]
    else:
        near, far = model.refocus_range_mm
        ends = [model.shift_mm(end) for end in (near, far)]
        found = [near, model.distance_mm(0.5 * ends[0]), model.distance_mm(0.0), model.distance_mm(0.5 * ends[1]), far]
    return sorted(distance for distance in found if distance > max(0.0, model.nearest_mm))


def _sharp_shift_mm(scene: Scene, model: RayModel) -> float:
    """Return the shift per view of planes that middle-type lenslets image sharply: 1/d − 1/ε = 1/f."""
    mla = scene.camera.mla
    assert mla is not None
    focal = sorted(lenslet_focal_length_mm(scene.camera, scene.primary_nm))
    excess = 1.0 / (1.0 / model.lenslet_to_sensor_mm - 1.0 / focal[len(focal) // 2])
    return model.slope_step * excess / (1.0 + excess / model.pupil_to_array_mm)


def _held_px(model: RayModel) -> float:
    """Return the usable radius of a micro-image in pixels, as in `render_patches`."""
    return min(0.5 * model.micro_image_pitch_px, model.pupil_slope / model.slope_step) - BORDER


def _crosstalk(rays: ArrayRays, model: RayModel, object_mm: float, height_mm: float) -> CrossTalk:
    """Compute the cross-talk of the lenslet nearest to an image height towards a corner."""
    pitch, calibration = model.lenslet_pitch_mm, rays.calibration
    reach = model.lenslet_to_sensor_mm * model.pupil_slope + 0.5 * pitch
    # The cells of a ring begin half a pitch nearer, and the rows of hexagonal arrays are closer together.
    rings = min(MOST_RINGS, max(1, math.floor(reach / pitch + CLOSER)))
    rows, columns = calibration.known.shape
    inner = np.zeros((rows, columns), bool)
    border = [min(rings, (side - 1) // 2) for side in (rows, columns)]
    inner[border[0] : rows - border[0], border[1] : columns - border[1]] = True
    apexes = rays.apexes
    corner = apexes.max(axis=0)
    off = np.hypot(*(apexes - height_mm * corner / np.hypot(*corner)).T)
    chosen = int(np.where(inner.ravel() & calibration.known.ravel(), off, np.inf).argmin())
    lens = LensRays(rays.world, object_mm, rays.image_z_mm)
    scale = paraxial_scale(lens, rays.wavelength_nm)
    moved = rays.moved_point(object_mm, apexes[chosen] / scale, pitch / abs(scale), parts=8)
    side = (2 * rings + 1) * pitch
    count = 1 << (PLACES * (2 * rings + 1) ** 2 - 1).bit_length()
    places = apexes[chosen] + side * (even_points(count) - 0.5)
    landed = rays.across_plane(moved, places)
    _, cell = rays.cells.query(landed.pixels)
    own, through = cell == chosen, landed.lenslet == chosen
    both = float(landed.weight[own & through].sum())
    return CrossTalk(
        float(np.hypot(*apexes[chosen])),
        (chosen % columns, chosen // columns),
        _share(float(landed.weight[own].sum()), both),
        _share(float(landed.weight[through].sum()), both),
    )


def _share(whole: float, without: float) -> float:
    return 1.0 - without / whole if whole > 0.0 else math.nan


def photograph_mtf(rays: ArrayRays, distance_mm: float, frequencies: Array, *, by_patches: bool) -> Array:
    """Return the MTF of the photograph of a plane on the axis, for each of its parts, (3, f).

    Parameters
    ----------
    rays : ArrayRays
    distance_mm : float
        Distance before the first vertex; may be inf.
    frequencies : (f,) float64, 1/mm
        Frequencies on the array.
    by_patches : bool
        Photograph by `render_patches`; otherwise by `refocus`.
    """
    scene = rays.world.scene
    model = RayModel.of(scene)
    finite = min(distance_mm, FAR * abs(model.efl_mm))
    to_picture = finite / model.object_scale(finite)
    cell = np.array([model.lenslet_pitch_mm, rays.calibration.row_pitch_mm])
    if rays.calibration.layout == "hexagonal":
        cell[1] *= 2.0
    moves = (even_points(POINTS) - 0.5) * cell / to_picture
    moved = rays.moved_point(distance_mm, np.zeros(2), cell[0] / to_picture, parts=4)
    landed = rays.from_object(moved, moves)
    ideal = to_picture * moves[landed.point, 0]
    spread = _spread_of_patches if by_patches else _spread_of_views
    return spread(rays, model, distance_mm, landed, ideal, frequencies)


def _spread_of_views(
    rays: ArrayRays, model: RayModel, distance_mm: float, landed: Landed, ideal: Array, frequencies: Array
) -> Array:
    """Return the MTF of the middle view, an edge view and the refocused photograph, (3, f)."""
    calibration, upright = rays.calibration, Upright.of(rays.world.scene)
    count, sampling = view_count(calibration, None), sampling_of(calibration, upright)
    middle = 0.5 * (count - 1)
    spacing = sampling.s_mm[1] - sampling.s_mm[0] if len(sampling.s_mm) > 1 else model.lenslet_pitch_mm
    along = model.shift_mm(distance_mm) / spacing
    columns, shares = _samples_of_columns(sampling.columns, sampling.share, calibration.known.shape[1])
    ray, lenslet, off = _beside_centres(rays, landed, CANDIDATES, math.inf)
    u, v = (sense * part + middle for sense, part in zip(upright.senses, off.T, strict=True))
    row, column = np.divmod(lenslet, calibration.known.shape[1])
    off_axis = model.slope_step * np.abs(np.arange(count) - middle)
    whole = np.flatnonzero(off_axis <= model.pupil_slope - model.slope_step)
    edge, central = int(whole.max(initial=-1)), count // 2
    sums = [_Spread(model.lenslet_pitch_mm) for _ in VIEWS]
    for i in (0, 1):
        at_u = np.floor(u).astype(np.int64) + i
        by_u = 1.0 - np.abs(u - at_u)
        for j in (0, 1):
            at_v = np.floor(v).astype(np.int64) + j
            seen = (at_u >= 0) & (at_u < count) & (at_v >= 0) & (at_v < count)
            weight = np.where(seen, by_u * (1.0 - np.abs(v - at_v)) * landed.weight[ray], 0.0)
            for k in range(columns.shape[2]):
                sample, share = columns[row & 1, column, k], shares[row & 1, column, k]
                place, light = spacing * (sample - 0.5 * (len(sampling.s_mm) - 1)) - ideal[ray], weight * share
                in_row = np.where(at_v == central, light, 0.0)
                sums[0].add(place, np.where(at_u == central, in_row, 0.0))
                sums[1].add(place, np.where(at_u == edge, in_row, 0.0))
                moved = along * (at_u - middle)
                rest = (-moved) % 1.0
                sums[2].add(place + spacing * (moved + rest), light * (1.0 - rest))
                sums[2].add(place + spacing * (moved + rest - 1.0), light * rest)
    return np.array([each.mtf(frequencies) for each in sums])


def _spread_of_patches(
    rays: ArrayRays, model: RayModel, distance_mm: float, landed: Landed, ideal: Array, frequencies: Array
) -> Array:
    """Return the MTF of a photograph from patches, for the inner pixels, the outer pixels and all, (3, f)."""
    shift, radius = model.shift_mm(distance_mm), _held_px(model)
    blur = np.array(lenslet_blur_px(rays.world.scene, model.image_excess_mm(distance_mm)))
    sharpest = np.flatnonzero(blur <= blur.min() * (1.0 + 1e-9))
    ray, lenslet, off = _beside_centres(rays, landed, MOST_PATCHES, radius)
    sharp = np.isin(rays.calibration.kinds.ravel()[lenslet], sharpest)
    square = (off * off).sum(axis=1) / radius**2
    light = np.where(sharp, landed.weight[ray] * (1.0 - square), 0.0)
    apexes = rays.plate.apexes[lenslet, 0]
    place = Upright.of(rays.world.scene).senses[0] * (apexes + shift * off[:, 0]) - ideal[ray]
    # Linear interpolation between pixels.
    between = np.sinc(frequencies * shift) ** 2
    found = []
    for which in (square <= 0.25, square > 0.25, square <= 1.0):
        spread = _Spread(model.lenslet_pitch_mm)
        spread.add(place, np.where(which, light, 0.0))
        found.append(spread.mtf(frequencies) * between)
    return np.array(found)


class _Spread:
    """Spread of a point's light over a photograph, in narrow bins along +x."""

    def __init__(self, pitch_mm: float) -> None:
        self.width_mm, self.first = pitch_mm / BINS, 0
        self.light: Array = np.zeros(0)

    def add(self, place_mm: Array, light: Array) -> None:
        """Add light at (n,) places."""
        place_mm, light = place_mm[light > 0.0], light[light > 0.0]
        if not len(light):
            return
        number = np.floor(place_mm / self.width_mm).astype(np.int64)
        first = min(int(number.min()), self.first)
        more = np.bincount(number - first, light)
        joined = np.zeros(max(len(more), len(self.light) + self.first - first))
        joined[self.first - first :][: len(self.light)] = self.light
        joined[: len(more)] += more
        self.first, self.light = first, joined

    def mtf(self, frequencies: Array) -> Array:
        """Return the normalised modulus of the spread's transform, (f,); NaN without light."""
        total = self.light.sum()
        if not total > 0.0:
            return np.full(len(frequencies), np.nan)
        place = self.width_mm * np.arange(len(self.light))
        return np.asarray(np.abs(np.exp(-2j * np.pi * np.multiply.outer(frequencies, place)) @ self.light) / total)


def _beside_centres(rays: ArrayRays, landed: Landed, most: int, reach_px: float) -> tuple[Whole, Whole, Array]:
    """Pair rays with micro-images near their pixels, and return the offsets from the centres in pixels.

    Returns
    -------
    ray, lenslet : (n,) int64
    off : (n, 2) float64
    """
    columns, rows = rays.world.scene.camera.sensor.pixels
    pixels = np.floor(landed.pixels + 0.5)
    on = ((pixels >= 0.0) & (pixels < (columns, rows))).all(axis=1)
    number = np.flatnonzero(on)
    centres = np.asarray(rays.cells.data)
    most = min(most, len(centres))
    away, found = rays.cells.query(pixels[number], k=most, distance_upper_bound=reach_px)
    near = np.isfinite(away.reshape(len(number), most))
    which, order = np.nonzero(near)
    lenslet = found.reshape(len(number), most)[which, order].astype(np.int64)
    ray = number[which]
    return ray, lenslet, pixels[ray] - centres[lenslet]


def _samples_of_columns(columns: Whole, share: Array, count: int) -> tuple[Whole, Array]:
    """Return the samples of a row that take light from each lenslet, and their weights, (2, columns, m) each."""
    parity = np.repeat([0, 1], columns.shape[1])
    sample = np.tile(np.arange(columns.shape[1]), 2)
    entries = [(parity, columns.ravel(), sample, 1.0 - share.ravel())]
    entries.append((parity, columns.ravel() + 1, sample, share.ravel()))
    p, c, s, w = (np.concatenate(each) for each in zip(*entries, strict=True))
    taken = (w > 0.0) & (c < count)
    p, c, s, w = p[taken], c[taken], s[taken], w[taken]
    order = np.argsort(p * count + c, kind="stable")
    key = (p * count + c)[order]
    rank = np.arange(len(key)) - np.searchsorted(key, key)
    samples = np.zeros((2 * count, int(rank.max(initial=0)) + 1), np.int64)
    weights = np.zeros(samples.shape)
    samples[key, rank], weights[key, rank] = s[order], w[order]
    return samples.reshape(2, count, -1), weights.reshape(2, count, -1)
