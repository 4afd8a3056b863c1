"""Key figures of results as names and values in words, for notebooks."""

import math
from collections.abc import Sequence
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from lfmesh.analysis.analysis import LensAnalysis
from lfmesh.errors import LfmeshError
from lfmesh.files.words import count, duration, noise
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.detector import Exposed
from lfmesh.lightfield.photographs.depth import DepthMap
from lfmesh.lightfield.photographs.depth_truth import DepthTruth
from lfmesh.lightfield.photographs.photograph import AllInFocus, FocalStack, Photograph
from lfmesh.lightfield.photographs.schlieren import Schlieren
from lfmesh.lightfield.views.field import LightField
from lfmesh.scene import FirstOrder, Scene
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.literals import counted, percent
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.packets.packet import Status
from lfmesh.transport.render.image import Image
from lfmesh.transport.traced_paths import Paths
from lfmesh.transport.world import World
from lfmesh.waves.point_spread import PointSpread
from lfmesh.waves.wavefront import Wavefront

Rows = list[tuple[str, str]]

MOST_MEASURED = 4_000_000
"""Largest image with a displayed noise measurement, which takes some microseconds per pixel."""


@singledispatch
def key_figures(result: object) -> Rows:
    """Return the key figures of a result: names and values."""
    raise LfmeshError(f"a {type(result).__name__} has no key figures")


def _channels(wavelengths_nm: Sequence[float], names: Sequence[str] = ()) -> tuple[str, str]:
    if names:
        return "bands", ", ".join(names)
    shown = ", ".join(f"{wavelength:g}" for wavelength in wavelengths_nm)
    return f"wavelength{'s' if len(wavelengths_nm) > 1 else ''}", f"{shown} nm"


def _distance(length_mm: float) -> str:
    return f"{length_mm:,.6g} mm" if math.isfinite(length_mm) else "infinity"


def _before_lens(length_mm: float) -> str:
    return f"{_distance(length_mm)} before the first vertex" if math.isfinite(length_mm) else "infinity"


@key_figures.register
def _(image: Image) -> Rows:
    rows, columns = image.mean.shape[:2]
    known = "unknown: fewer than 2 replicates"
    if image.mean.size > MOST_MEASURED:
        known = "in image.error"
    elif (measured := noise(image).relative_error) is not None:
        known = f"median {percent(measured[1])} of a lit pixel"
    return [
        *(("warning", str(warning)) for warning in image.warnings),
        ("pixels", f"{columns} × {rows}"),
        _channels(image.wavelengths_nm, image.channel_names),
        ("samples", f"{image.samples:g} per pixel"),
        ("replicates", f"{image.replicates} of {image.scene.transport.replicates}"),
        ("standard error", known),
        ("light on the sensor", f"{image.mean.sum():.4g} W"),
        ("pixels with light", percent(float((image.mean > 0.0).mean()))),
        ("energy lost", percent(image.ledger.lost_share)),
        ("traced", f"{count(image.ledger.packets)} packets in {duration(image.seconds)}"),
    ]


@key_figures.register
def _(field: LightField) -> Rows:
    rows, columns = field.views
    height, width = field.size
    return [
        ("views", f"{columns} × {rows}"),
        ("samples per view", f"{width} × {height}"),
        _channels(field.wavelengths_nm, field.scene.channel_names),
        ("unit", field.unit),
        ("sampling", field.sampling),
        ("samples without light", percent(float(np.isnan(field.data).mean()))),
    ]


@key_figures.register
def _(photograph: Photograph) -> Rows:
    height, width = photograph.mean.shape[:2]
    return [
        ("focused on", _before_lens(photograph.distance_mm)),
        ("aperture", f"f/{photograph.f_number:.3g}"),
        ("samples", f"{width} × {height}, {photograph.sample_mm:.3g} mm each in that plane"),
        _channels(photograph.wavelengths_nm),
        ("unit", photograph.unit),
    ]


@key_figures.register
def _(stack: FocalStack) -> Rows:
    planes = stack.distances_mm
    height, width = stack.photographs[0].mean.shape[:2]
    return [
        ("planes", f"{len(planes)}, from {_distance(min(planes))} to {_distance(max(planes))}"),
        ("samples", f"{width} × {height}"),
        _channels(stack.photographs[0].wavelengths_nm),
        ("unit", stack.photographs[0].unit),
    ]


@key_figures.register
def _(sharp: AllInFocus) -> Rows:
    height, width = sharp.mean.shape[:2]
    return [
        ("samples", f"{width} × {height}"),
        ("planes", f"{sharp.distance_mm.min():,.5g} to {sharp.distance_mm.max():,.5g} mm"),
        _channels(sharp.wavelengths_nm),
        ("unit", sharp.unit),
    ]


def _of_depth(values: NDArray[np.floating]) -> Rows:
    height, width = values.shape
    known = values[np.isfinite(values)]
    middle = f"{np.median(known):,.5g} mm" if known.size else "none"
    return [
        ("samples", f"{width} × {height}"),
        ("with a depth", percent(known.size / values.size)),
        ("median", middle),
    ]


@key_figures.register
def _(depth: DepthMap) -> Rows:
    nearest, farthest = depth.range_mm
    return [*_of_depth(depth.distance_mm), ("searched", f"{nearest:,.5g} to {farthest:,.5g} mm")]


@key_figures.register
def _(truth: DepthTruth) -> Rows:
    views_v, views_u = truth.views_mm.shape[:2]
    return [("views", f"{views_u} × {views_v}"), *_of_depth(truth.middle_mm)]


@key_figures.register
def _(result: Schlieren) -> Rows:
    rows, columns = result.misfit.shape[-2:]
    known = result.deflection_rad[np.isfinite(result.deflection_rad)]
    error = result.deflection_error_rad[np.isfinite(result.deflection_rad)]
    figures = [("windows", f"{columns} × {rows}"), ("known", percent(float(np.isfinite(result.misfit).mean())))]
    if known.size:
        figures.append(("largest deflection", f"{1e3 * np.abs(known).max():.4g} mrad"))
        figures.append(("median standard error", f"{1e3 * np.median(error):.2g} mrad"))
    return [*figures, ("background", f"{result.background_mm:,.5g} mm"), ("flow", f"{result.field_mm:,.5g} mm")]


@key_figures.register
def _(exposed: Exposed) -> Rows:
    height, width = exposed.counts.shape
    detector = exposed.detector
    return [
        ("pixels", f"{width} × {height}"),
        ("exposure", f"{detector.exposure_s:g} s"),
        ("colour filters", detector.bayer or "none"),
        ("largest count", f"{exposed.counts.max()} of {2**detector.bits - 1}"),
        ("full wells", percent(float(exposed.saturated.mean()))),
    ]


@key_figures.register
def _(report: FirstOrder) -> Rows:
    return report.rows()


@key_figures.register
def _(analysis: LensAnalysis) -> Rows:
    facts = analysis.first_order
    at = "infinity" if math.isinf(analysis.object_mm) else f"{analysis.object_mm:.6g} mm"
    rows = [
        ("focal length", f"{facts.efl_mm:.4f} mm, working f/{facts.working_f_number:.3f}"),
        ("object", at),
        ("image plane", f"z = {analysis.image_z_mm:z.4f} mm"),
        _channels(analysis.wavelengths_nm),
        ("Airy radius", f"{1e3 * analysis.airy_radius_mm:.3f} µm"),
    ]
    spots = zip(analysis.heights_mm, analysis.spots, strict=True)
    return rows + [
        (f"spot at {height:.2f} mm", f"rms {1e3 * spot.rms_mm:.2f} µm, {spot.passed:.1%} of the rays pass")
        for height, spot in spots
    ]


@key_figures.register
def _(ledger: Ledger) -> Rows:
    ends = [("sensor", ledger.sensor), *ledger.absorbed.items(), ("left the scene", ledger.escaped)]
    ends += [("cut by max_events", ledger.depth), ("lost to rounding", sum(ledger.lost.values()))]
    into = ledger.emitted or 1.0
    rows = [("emitted", f"{ledger.emitted:.6g} {ledger.unit}")]
    rows += [(name, percent(share / into)) for name, share in sorted(ends, key=lambda end: -end[1]) if share > 0.0]
    return [*rows, ("not closed", f"{ledger.imbalance:.1e} of the emitted power")]


@key_figures.register
def _(paths: Paths) -> Rows:
    rows = [("packets", f"{len(paths):,}"), ("total weight", f"{paths.weight.sum():.6g}")]
    for status in Status:
        of_status = paths.status == status
        if of_status.any():
            weight = paths.weight[of_status].sum()
            rows.append((status.name.lower(), f"{int(of_status.sum()):,} packets of weight {weight:.6g}"))
    return [*rows, ("most interfaces of a packet", f"{int(paths.events.max(initial=0))}")]


@key_figures.register
def _(world: World) -> Rows:
    mla = world.scene.camera.mla
    targets = [target.name or f"targets[{i}]" for i, target in enumerate(world.scene.targets)]
    shape = world.lens_shape
    gradients = sum(isinstance(shape.media[k + 1], Gradient) for k in shape.elements)
    elements = counted(len(shape.elements), "element") + (f", {gradients} of gradient-index glass" if gradients else "")
    return [
        ("scene", world.scene.title or "unnamed"),
        ("lens", f"{elements}, f = {world.facts.efl_mm:.4g} mm"),
        ("array", "none" if mla is None else f"{mla.count[0]} × {mla.count[1]} lenslets"),
        ("sensor", "{} × {} pixels".format(*world.scene.camera.sensor.pixels)),
        ("targets", ", ".join(targets) or "none"),
        ("lights", str(len(world.scene.lights))),
    ]


@key_figures.register
def _(scene: Scene) -> Rows:
    camera = scene.camera
    targets = [target.name or f"targets[{i}]" for i, target in enumerate(scene.targets)]
    transport = scene.transport
    rows = [("scene", scene.title or "unnamed"), ("targets", ", ".join(targets) or "none")]
    rows += [("lights", str(len(scene.lights))), ("sensor", "{} × {} pixels".format(*camera.sensor.pixels))]
    if camera.mla is not None:
        rows.append(("array", f"{camera.mla.count[0]} × {camera.mla.count[1]} lenslets"))
    rows.append(("transport", f"{transport.method}, {transport.samples} samples, {transport.replicates} replicates"))
    try:
        facts = solved_camera(scene).report
    except LfmeshError as fault:
        return [*rows, ("cannot be solved", str(fault))]
    focus = f"{facts.object_distance_mm:,.5g} mm"
    return [*rows, ("focus", focus), ("lens", f"f = {facts.efl_mm:.4g} mm, working f/{facts.working_f_number:.3g}")]


@key_figures.register
def _(spread: PointSpread) -> Rows:
    rows, columns = spread.mean.shape
    lit = (
        ("Strehl ratio", f"{spread.strehl:.4g}")
        if spread.strehl is not None
        else ("lenslets lit", f"{spread.lenslets}")
    )
    return [
        ("point", "({:zg}, {:zg}, {:zg}) mm in the camera frame".format(*spread.point_mm)),
        _channels(spread.wavelengths_nm),
        ("samples", f"{columns} × {rows}, {1e3 * spread.step_mm:.4g} µm each"),
        lit,
        ("peak", f"{spread.peak_w_mm2:.4g} W/mm² per W/sr"),
        ("Airy radius", f"{1e3 * spread.airy_radius_mm:.4g} µm"),
        ("light in the sensor plane", f"{spread.power_w:.4g} W per W/sr"),
        ("last change", percent(spread.change)),
    ]


@key_figures.register
def _(found: Wavefront) -> Rows:
    return [
        _channels([found.wavelength_nm]),
        ("root mean square", f"{found.rms_waves:.4g} waves"),
        ("peak to valley", f"{found.pv_waves:.4g} waves"),
        ("Strehl ratio", f"{found.strehl:.4g}"),
        ("reference sphere", f"radius {found.radius_mm:.6g} mm"),
        ("stop", f"{percent(found.passed)} of it passes light"),
    ]
