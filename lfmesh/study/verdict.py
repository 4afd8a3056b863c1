"""What the measured numbers of an accuracy report say, in plain words: what to choose, and what that costs."""

import math
from collections.abc import Sequence

from lfmesh.study.image_efficiency import ANALOG, WAYS, ImageStudy
from lfmesh.study.lens_accuracy import LENS_ALONE, LEVELS, LensRow, LensStudy, order_of

GOOD_PIXELS = 0.1
"""An rms error below this share of a pixel does not show in an image."""

TIE = 1.25
"""Speeds, or efficiencies, closer than this factor count as equal."""


def cheapest_good(rows: Sequence[LensRow]) -> LensRow | None:
    """Return the row with the fewest triangles whose error stays below a tenth of a pixel."""
    good = [row for row in rows if row.rms_px <= GOOD_PIXELS]
    return min(good, key=lambda row: row.triangles, default=None)


def about_the_truth(study: LensStudy) -> str:
    """Say how far the truth can be trusted."""
    if study.truth_error_mm is None:
        return (
            "The truth is a trace through the analytic surfaces in float64; its own rounding error could not be measured "
            "here, for this machine's long double is no wider."
        )
    return (
        "The truth is a trace through the analytic surfaces in float64 that shares no code with the tracer; the same trace "
        f"in extended precision lands within {study.truth_error_mm:.1e} mm of it."
    )


def about_triangles(study: LensStudy, way: str) -> str:
    """Say how each level's error falls with the mesh, and which to choose for accuracy."""
    sentences = [_level_words(study, way, level) for level in LEVELS]
    exact = study.of(way, "exact")
    best = exact[0]
    sentences.append(
        f"Choose exact wherever the surfaces have a formula: {best.triangles:,} triangles a surface, the default, are "
        f"enough for {best.rms_mm:.0e} mm, and more of them change nothing."
    )
    mesh_only = [row for level in ("patch", "smooth", "flat") if (row := cheapest_good(study.of(way, level)))]
    if mesh_only:
        cheapest = min(mesh_only, key=lambda row: row.triangles)
        sentences.append(
            f"For glass that is only a mesh, {cheapest.surface} is the coarsest to stay below a tenth of a pixel, from "
            f"{cheapest.triangles:,} triangles a surface on."
        )
    else:
        sentences.append("For glass that is only a mesh, none of the meshes measured stays below a tenth of a pixel.")
    return " ".join(sentences)


def about_time(study: LensStudy, way: str) -> str:
    """Say what the levels cost in time, memory and building."""
    rows = study.of(way)
    exact = study.of(way, "exact")[0]
    fastest = max(rows, key=lambda row: row.events_per_second)
    patch = study.of(way, "patch")
    words = [
        f"On its default mesh exact shades {_millions(exact.events_per_second)} events a second on one core; the fastest "
        f"of all, {fastest.surface} with {fastest.triangles:,} triangles, {_millions(fastest.events_per_second)}."
    ]
    good = cheapest_good(patch) or cheapest_good(study.of(way, "smooth"))
    if good is not None:
        ratio = exact.events_per_second / good.events_per_second
        against = "as fast as" if 1 / TIE <= ratio <= TIE else f"{ratio:.2g} times as fast as"
        words.append(
            f"It is {against} the coarsest {good.surface} mesh that stays below a tenth of a pixel, which errs by "
            f"{good.rms_mm:.1e} mm: coarser levels buy no time."
            if ratio >= 1 / TIE
            else f"The coarsest {good.surface} mesh below a tenth of a pixel is {1 / ratio:.2g} times as fast, at an "
            f"error of {good.rms_mm:.1e} mm."
        )
    finest = max(rows, key=lambda row: row.triangles)
    words.append(
        f"The finest mesh, {finest.triangles:,} triangles a surface, took {finest.build_seconds:.2g} s to build and "
        f"{finest.table_bytes / 1e6:.3g} MB of tables; the default of exact {exact.build_seconds:.2g} s and "
        f"{exact.table_bytes / 1e6:.3g} MB."
    )
    worst = max(rows, key=lambda row: row.lost)
    words.append(
        "No ray was lost."
        if worst.lost == 0.0
        else f"At most {worst.lost:.1e} of the power was lost, by {worst.surface} with {worst.triangles:,} triangles."
    )
    return " ".join(words)


def about_images(study: ImageStudy) -> str:
    """Say which way to estimate an image is the most efficient, and by how much."""
    ranked = sorted((way for way in WAYS if study.of(way)), key=study.efficiency, reverse=True)
    best = ranked[0]
    words = [f"The most efficient way is {best.name}, at {study.efficiency(best):.3g} 1/s: choose it."]
    for way in ranked[1:]:
        ratio, error = study.gain(best, way)
        words.append(f"It is {_factor(ratio, error)} times as efficient as {way.name}.")
    forward = [way for way in ranked if way.method == "forward" and way is not ANALOG]
    if forward and study.of(ANALOG):
        ratio, error = study.gain(forward[0], ANALOG)
        words.append(f"Light that must be traced forward: {forward[0].name} gains {_factor(ratio, error)} over analog.")
    words.append(
        f"To halve an error costs {best.name} at most four times the time. The reference of {study.reference_samples} "
        f"samples a pixel has an rms error of {100 * study.reference_error:.2g} % itself, which is taken off the errors "
        "shown."
    )
    if study.binned > 1:
        words.append(
            f"Measured with {study.binned} × {study.binned} pixels of the sensor joined into one "
            f"({study.pixels[0]} × {study.pixels[1]} in all), so that the inefficient ways get anywhere."
        )
    return " ".join(words)


def three_numbers(study: LensStudy) -> list[str]:
    """Return the numbers that a user needs first, one line each."""
    exact = study.of(LENS_ALONE, "exact")[0]
    lines = [
        f"exact, {exact.triangles} triangles a surface: rays land within {exact.max_mm:.1e} mm of the truth "
        f"({_millions(exact.events_per_second)} events a second and core)"
    ]
    patch = cheapest_good(study.of(LENS_ALONE, "patch"))
    if patch is not None:
        lines.append(
            f"patch, for glass that is only a mesh: {patch.triangles} triangles a surface err by {patch.rms_px:.2g} pixels"
        )
    flat = study.of(LENS_ALONE, "flat")[-1]
    lines.append(f"flat facets, {flat.triangles:,} triangles a surface: still {flat.rms_px:.2g} pixels off")
    return lines


def _level_words(study: LensStudy, way: str, level: str) -> str:
    rows = study.of(way, level)
    first, last = rows[0], rows[-1]
    if level == "exact":
        return f"With exact rays land within {max(row.max_mm for row in rows):.1e} mm on every mesh."
    order = order_of(rows)
    falls = f"with order {order:.1f} " if math.isfinite(order) else ""
    return (
        f"With {level} the error falls {falls}in the size of the facets, from {first.rms_mm:.1e} mm at "
        f"{first.triangles:,} triangles a surface to {last.rms_mm:.1e} mm ({last.rms_px:.2g} pixels) at {last.triangles:,}."
    )


def _millions(rate: float) -> str:
    return f"{rate / 1e6:.2g} million"


def _factor(ratio: float, error: float) -> str:
    """Return a ratio with as many digits as its error leaves it."""
    if not math.isfinite(error) or error <= 0.0:
        return f"{ratio:.3g}"
    digits = max(0, -math.floor(math.log10(error)))
    return f"{ratio:.{digits}f} ± {error:.{digits}f}"
