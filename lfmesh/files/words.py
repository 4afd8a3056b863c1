"""Summary of a run in words: the noise of the picture and, if it is dark, the fate of the light."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.objects.placement import placements
from lfmesh.geometry.objects.targets import named_target
from lfmesh.scene import Scene
from lfmesh.scene.literals import percent, plain
from lfmesh.scene.motion import at_begin
from lfmesh.transport.checks.found import few_hits_share, lit_pixels
from lfmesh.transport.render.adaptive import Refinement
from lfmesh.transport.render.certainty import typical_over_rms
from lfmesh.transport.render.image import Image
from lfmesh.transport.tables.phase_faces import has_orders, lost_orders
from lfmesh.transport.tables.spectra import reflectance_at

DARK_SHARE = 0.1
"""A picture is dark if the fraction of pixels that received light is below this."""

MOST_ENDS, MOST_TARGETS = 4, 3
"""Most places and targets that a sentence lists."""

BEFORE_LENS = {
    "sensor", "beside the sensor", "housing", "reflections not followed",
    "mla mount", "mla edge", "mla wall", "mla mask",
}  # fmt: skip
"""Ledger entries for places between sensor and lens."""

BEYOND_LENS = "beyond the lens"

WITHOUT_PLACE = {
    BEYOND_LENS: "left through the front",
    "sensor": "reached the sensor",
    "beside the sensor": "fell beside the sensor",
    "escaped": "left the scene",
    "rounding": "was lost to rounding",
    "reflections not followed": "went into untraced reflections",
    "étendue of thin lenses": "was lost because thin lenses do not conserve étendue",
    "diffracted beyond a right angle": "was diffracted by more than a right angle",
}
"""Words for ledger entries that are not bodies."""


@dataclass(frozen=True)
class Noise:
    """Summary of the pixels' standard errors.

    Attributes
    ----------
    received_share : float
        Fraction of pixels that received light.
    lit_share : float
        Fraction of lit pixels: above 5 % of the bright ones (99th percentile of the pixels with light).
    relative_error : tuple of float, or None
        Quartiles over the lit pixels of error / mean; the error is pooled over neighbours (`Image.error`) and corrected
        for the number of replicates. None without light or with a single replicate.
    without_hits : int or None
        Pixels for which no path found light at any wavelength; None if hits were not counted.
    few_hits_share : float or None
        Fraction of lit pixels with fewer than `FEW_HITS` hits.
    """

    received_share: float
    lit_share: float
    relative_error: tuple[float, float, float] | None
    without_hits: int | None
    few_hits_share: float | None


def noise(image: Image) -> Noise:
    """Measure the noise of an image over pixels and wavelengths."""
    received = image.mean > 0.0
    # Light added without tracing has no hits.
    without = None if image.hits is None else int((~(image.hits.any(axis=2) | received.any(axis=2))).sum())
    if not received.any():
        return Noise(0.0, 0.0, None, without, None)
    lit = lit_pixels(image.mean)
    few = few_hits_share(image, lit)
    return Noise(float(received.mean()), float(lit.mean()), _quartiles(image, lit), without, few)


def _quartiles(image: Image, lit: NDArray[np.bool_]) -> tuple[float, float, float] | None:
    """Return the quartiles of the relative error over the lit pixels."""
    if image.replicates < 2:
        return None
    relative = np.empty(int(lit.sum()), np.float32)
    first = 0
    for rows, error, pooled in image.errors_by_rows():
        here = lit[rows]
        part = error[here] / (image.mean[rows][here] * typical_over_rms(pooled[here], image.groups))
        relative[first : first + len(part)] = part
        first += len(part)
    known = relative[np.isfinite(relative)]
    if not known.size:
        return None
    low, middle, high = np.quantile(known, [0.25, 0.5, 0.75], overwrite_input=True)
    return float(low), float(middle), float(high)


def summary(image: Image) -> list[str]:
    """Summarise a run, one plain sentence per line: warnings, noise, checks and work done."""
    return [*(f"Warning: {warning}" for warning in image.warnings), *account(image, verbose=True)]


def account(image: Image, *, verbose: bool = False) -> list[str]:
    """Summarise a run without its warnings, which are printed as they occur.

    Parameters
    ----------
    image : Image
    verbose : bool
        Include the aim, coating tables, diffraction and the work done. Otherwise one line of checks follows the noise.
    """
    measured = noise(image)
    lines = [*_noise_lines(image, measured), *_untraced(image)]
    if measured.received_share < DARK_SHARE:
        lines += where_the_light_went(image)
    unaimed, order = _unaimed(image), _order(image)
    if verbose:
        details = [*_aim(image), *_coatings(image), *_diffraction(image.scene), _work(image)]
        return [*lines, *unaimed, *order, *details]
    checks = " ".join([*unaimed, *order, *(_aim(image) if image.aim is None else [])])
    return [*lines, *([f"Checks: {checks}"] if checks else [])]


def _untraced(image: Image) -> list[str]:
    """Return a sentence on light that was added without tracing, and so without noise."""
    light, total = image.ledger.untraced, float(image.mean.sum())
    if not light > 0.0:
        return []
    return [
        f"Particles, pictured by point spreads, bring {light:.3g} W, {percent(light / total)} of the picture's light."
    ]


def diffraction(scene: Scene) -> dict[str, float | None]:
    """Return the Airy disks that geometric optics neglects, as stored in a report; see `FirstOrder`."""
    facts = solved_camera(scene).report
    names = ("airy_wavelength_nm", "airy_disk_mm", "airy_disk_samples", "microlens_airy_disk_px")
    return {name: getattr(facts, name) for name in names}


def _diffraction(scene: Scene) -> list[str]:
    """Return a sentence on the Airy disks that geometric optics neglects, where they do not dominate."""
    facts = solved_camera(scene).report
    mla = facts.microlens_airy_disk_px is not None
    width = f"{plain(facts.airy_disk_samples, 2)} {'lenslets' if mla else 'pixels'} wide"
    if scene.transport.diffraction == "lenslets":
        return [f"Diffraction is traced at the lenslets only; the lens's Airy disk is {width}."]
    if scene.transport.diffraction == "stop":
        return [f"Diffraction is traced at the stop: the lens's Airy disk is {width}."]
    widths = [f"the lens's Airy disk is {width}"]
    largest = facts.airy_disk_samples
    if facts.microlens_airy_disk_px is not None:
        widths.append(f"a lenslet's {plain(facts.microlens_airy_disk_px, 2)} pixels")
        largest = max(largest, facts.microlens_airy_disk_px)
    if largest > 1.0:
        return []
    return [f"Diffraction is not traced: {', '.join(widths)} (at {facts.airy_wavelength_nm:g} nm)."]


def _aim(image: Image) -> list[str]:
    """Return a sentence on the light that aimed sampling misses, measured by rays from the stop."""
    proof, blind = image.aim, image.blind
    if blind is None or not blind.agrees:
        return []
    if image.scene.rough_in_camera():
        return ["Rays go to the whole lens, because surfaces of the camera scatter light."]
    if has_orders(image.scene):
        return ["Rays go to the whole lens, because a phase of the camera has several orders."]
    if proof is None and image.scene.camera.lens.has_meshes:
        return ["The aim is not proven."]
    if proof is None:
        return ["The aim is not proven, because no ray from the stop could be traced to the sensor."]
    said = f"The aim misses {percent(proof.missed)} ± {percent(max(proof.sensor.error, proof.objects.error))}"
    said += " of the light through the stop"
    if proof.diffracted is not None:
        said += f", and after diffraction {percent(proof.diffracted.share)} ± {percent(proof.diffracted.error)}"
    return [f"{said}."]


def _unaimed(image: Image) -> list[str]:
    """Return a sentence on light that only unaimed samples found."""
    blind = image.blind
    if blind is None or not blind.agrees:
        return []
    paths = "Unaimed samples" if image.scene.transport.method == "adjoint" else "Paths traced back from some pixels"
    if blind.smallest_deficit is None:
        return [f"{paths} are too few to show whether light is missing."]
    rows, columns = blind.blocks
    least = percent(blind.smallest_deficit)
    return [
        f"{paths} found no light missing in {rows} × {columns} blocks; in each they would have shown a loss above "
        f"{least}."
    ]


def _order(image: Image) -> list[str]:
    """Return a sentence comparing sequential lens and array surfaces with their meshes."""
    order = image.order
    if order is None or not order.holds:
        return []
    return [
        f"Sequential and mesh tracing agree on {order.compared:,} test paths (largest difference "
        f"{order.deviation_mm:.1e} mm)."
    ]


def _coatings(image: Image) -> list[str]:
    """Return a sentence on the accuracy of the coatings' reflectance tables."""
    if not image.coatings:
        return []
    names = f"coating{'s' if len(image.coatings) > 1 else ''} {', '.join(image.coatings)}"
    return [f"Reflectance of {names} comes from tables, to {max(image.coatings.values()):.0e} of the light."]


def where_the_light_went(image: Image) -> list[str]:
    """Return sentences on the causes of a dark picture, from the scene and the ledger."""
    ledger = image.ledger
    adjoint = image.scene.transport.method == "adjoint"
    ends = _ends(image)
    total = sum(ends.values())
    if total <= 0.0 and ledger.lamps is not None and ledger.lamps.emitted > 0.0:
        return [
            f"Only particles emit: {percent(ledger.lamps.sensor / ledger.lamps.emitted)} of their light reached the "
            "sensor."
        ]
    if total <= 0.0 and ledger.untraced > 0.0:
        return []
    if total <= 0.0:
        return ["No path left the sensor." if adjoint else "Nothing emits: the lights and targets have no power."]
    if not adjoint:
        return [f"Of the light, {_shares(image, ends)}.", *_reasons(image)]
    # Most paths from the sensor end before the lens, whatever the fault of the scene.
    to_lens = {name: share for name, share in ends.items() if name not in BEFORE_LENS}
    came = sum(to_lens.values())
    if not came > 0.0:
        return [_reached(image), f"None of them reached the lens: {_shares(image, ends)}."]
    in_lens = {name: share for name, share in to_lens.items() if name not in _outside(image.scene)}
    out = {BEYOND_LENS: came - sum(in_lens.values())}
    lens = f"{percent(came / total)} of the paths reached the lens; of these {_shares(image, out | in_lens)}."
    return [_reached(image), *_reasons(image), lens]


def duration(seconds: float) -> str:
    """Format a time in hours, minutes and seconds."""
    if seconds < 10.0:
        return f"{seconds:.1f} s"
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 120:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def count(number: float) -> str:
    """Format a large number to three digits: ``4.10 million``."""
    for size, word in ((1e12, "trillion"), (1e9, "billion"), (1e6, "million")):
        if number >= size:
            return f"{number / size:.3g} {word}"
    return f"{number:,.0f}"


def _work(image: Image) -> str:
    ledger = image.ledger
    line = f"Traced {count(ledger.packets)} packets and {count(ledger.events)} ray-surface events"
    line += f" in {duration(image.seconds)}"
    if image.seconds > 0.0:
        line += f" ({count(ledger.events / image.seconds)} events per second)"
    return f"{line}; {image.engine}." if image.engine else f"{line}."


def _noise_lines(image: Image, measured: Noise) -> list[str]:
    lines = []
    if measured.received_share == 0.0:
        return ["The picture is black: no light reached the sensor."]
    if measured.received_share < DARK_SHARE:
        lines.append(f"The picture is dark: only {percent(measured.received_share)} of the pixels got any light.")
    if measured.without_hits:
        lines.append(_without_hits(image, measured.without_hits))
    if measured.relative_error is None:
        return [*lines, "The noise is unknown: it takes at least 2 finished replicates."]
    if measured.relative_error[2] == 0.0:
        return [*lines, "Noise: none; every replicate gave the same picture."]
    quarter, half, most = (percent(error) for error in measured.relative_error)
    lines.append(
        f"Noise: at most {quarter} (one standard error) in a quarter of the lit pixels, {half} in half, {most} in "
        f"three quarters; 4 times the samples, {4 * image.samples:g} per pixel, would at least halve it."
    )
    if image.refinement is not None:
        lines.append(_refined(image.refinement))
    return lines


def _without_hits(image: Image, pixels: int) -> str:
    share = percent(pixels / (image.mean.shape[0] * image.mean.shape[1]))
    return (
        f"No path brought light to {pixels:,} pixels, {share}. Their value is 0; upper bounds are in image.upper."
        if pixels > 1
        else f"No path brought light to 1 pixel, {share}. Its value is 0; its upper bound is in image.upper."
    )


def _refined(refinement: Refinement) -> str:
    line = (
        f"Samples: {refinement.samples:.3g} per pixel on average; {percent(refinement.refined_share)} of the pixels "
        f"got more, for a standard error of {percent(refinement.target_error)}"
    )
    if refinement.capped_share > 0.0:
        line += f", and {percent(refinement.capped_share)} need more than max_samples = {refinement.max_samples}"
    return f"{line}."


def _ends(image: Image) -> dict[str, float]:
    """Return the light that ended at each place; roulette and aimed sampling are not places."""
    ledger = image.ledger
    return {
        **ledger.absorbed,
        "sensor": ledger.sensor,
        "escaped": ledger.escaped,
        "max_events": ledger.depth,
        "rounding": sum(ledger.lost.values()),
    }


def _outside(scene: Scene) -> set[str]:
    """Return the ledger's places in front of the lens."""
    bodies = [_in_ledger(scene, number) for number in range(len(scene.targets))]
    media = [medium.name or f"media[{i}]" for i, medium in enumerate(scene.media)]
    return {"escaped", *bodies, *media, *(f"inside {name}" for name in bodies)}


def _in_ledger(scene: Scene, number: int) -> str:
    """Return the name of a target in the ledger."""
    return scene.targets[number].name or f"targets[{number}]"


def _shares(image: Image, ends: dict[str, float]) -> str:
    """List the largest shares of the ended light, and the rest as one."""
    total = sum(ends.values())
    largest = sorted(ends, key=lambda name: -ends[name])[:MOST_ENDS]
    largest = [name for name in largest if ends[name] >= 0.001 * total]
    rest = total - sum(ends[name] for name in largest)
    parts = [f"{percent(ends[name] / total)} {_ended(name, image.scene)}" for name in largest]
    return ", ".join([*parts, *([f"{percent(rest / total)} elsewhere"] if rest >= 0.001 * total else [])])


def _ended(name: str, scene: Scene) -> str:
    """Return the fate of a share of light from its name in the ledger."""
    if name in WITHOUT_PLACE:
        return WITHOUT_PLACE[name]
    if name == "max_events":
        return f"was cut after {scene.transport.max_events} events (max_events)"
    if name.startswith("coating of "):
        return f"was absorbed by the {name}"
    if name.startswith("inside "):
        return f"was absorbed {name}"
    if name.startswith(lost_orders("")):
        return f"was lost in the {name}"
    return f"ended on {name}" if name.startswith(("targets[", "media[", "lens[")) else f"ended on the {name}"


def _reached(image: Image) -> str:
    """Return a sentence on the paths from the sensor that reached targets, and the light there."""
    ledger, scene = image.ledger, image.scene
    paths = "of the paths traced back from the sensor"
    opaque = [i for i, target in enumerate(scene.targets) if target.refractor is None]
    met = [named_target(scene, i) for i in opaque if ledger.absorbed.get(_in_ledger(scene, i), 0.0) > 0.0]
    if ledger.reached_target <= 0.0:
        black = sum(ledger.absorbed.get(_in_ledger(scene, i), 0.0) for i in opaque)
        if black > 0.0:
            return (
                f"{percent(black / ledger.emitted)} {paths} met the black side of a target, which neither emits nor "
                "scatters; none reached another side."
            )
        if ledger.escaped <= 0.0:
            return f"None {paths} reached a target, or even left the lens."
        return (
            f"None {paths} reached a target; {percent(ledger.escaped / ledger.emitted)} left the lens and met nothing."
        )
    where = " and ".join(met) if len(met) <= MOST_TARGETS else f"{len(met)} targets"
    reached = f"{percent(ledger.reached_target / ledger.emitted)} {paths} reached {where or 'a target'}"
    if ledger.lit <= 0.0:
        return f"{reached}, but nothing there emits or scatters the light of a lamp."
    facing = f"{reached}; {percent(ledger.lit / ledger.reached_target)} of these met a side that emits or faces a lamp"
    return facing + ("." if image.mean.any() else ", but something blocks the lamp.")


def _reasons(image: Image) -> list[str]:
    """Return sentences on targets that are hidden or give no light."""
    scene, ledger = image.scene, image.ledger
    with suppress(LfmeshError):
        # Skip the reasons if files have gone since the render.
        known = [str(warning) for warning in image.warnings]
        places = placements(scene)
        found = [f"{place.name} {why}" for place in places for why in place.warnings]
        lines = [f"{why}." for why in found if why not in known]
        for number, (target, place) in enumerate(zip(scene.targets, places, strict=True)):
            # No light ends on a target that scatters everything.
            own = target.shape is not None or not target.takes_materials
            takes = own and (reflectance_at(scene, number, scene.wavelengths_nm) < 1.0).any()
            ended = ledger.absorbed.get(_in_ledger(scene, number), 0.0)
            if place.share and target.refractor is None and takes and not ended and ledger.reached_target > 0.0:
                stands = at_begin("which stands in the field", target, scene.camera)
                lines.append(f"No path reached {place.name}, {stands}: it is small, or another body hides it.")
        return lines
    return []
