"""Conclusions from an accuracy report in plain words: recommendations and their cost."""

import math
from collections.abc import Sequence

from lfmesh.accuracy.image_efficiency import ANALOG, RANDOM, SOBOL, WAYS, ImageStudy, Way
from lfmesh.accuracy.lens_accuracy import LENS_ALONE, LEVELS, LensRow, LensStudy, order_of

GOOD_PIXELS = 0.1
"""Rms error, in pixels, below which it does not show in an image."""

TIE = 1.25
"""Factor within which speeds count as equal: they vary that much between runs on a busy machine."""

SURE = 2.0
"""Standard errors by which efficiencies must differ to be distinguished."""

MESH_LEVELS = ("patch", "smooth", "flat")
"""The levels that need no formula of the surface, best first."""

NO_LIGHT = "Nothing emits light in this scene: no images were measured."

UNITS = ((0.1, 1.0, "mm"), (1e-4, 1e3, "µm"), (1e-7, 1e6, "nm"))


def length(mm: float) -> str:
    """Return a length with two digits, in the most readable unit."""
    if mm == 0.0:
        return "0 mm"
    for least, scale, unit in UNITS:
        if abs(mm) >= least:
            return f"{two_digits(mm * scale)}\N{NO-BREAK SPACE}{unit}"
    return f"{power_of_ten(mm)}\N{NO-BREAK SPACE}mm"


def two_digits(value: float) -> str:
    """Return a number with two significant digits, without an exponent."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    # Use the exponent of the rounded number: 9.96 becomes 10.
    decimals = 1 - int(f"{value:.1e}".split("e")[1])
    return f"{round(value, decimals):,.{max(0, decimals)}f}"


def power_of_ten(value: float) -> str:
    """Return a number such as 1.5e-14 in typeset notation."""
    digits, exponent = f"{value:.1e}".split("e")
    signs = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
    return f"{digits}\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}10{str(int(exponent)).translate(signs)}"


def pixels(value: float) -> str:
    """Return a distance in pixels, in words."""
    return f"{two_digits(value) if value >= 1e-3 else power_of_ten(value)} pixels"


def percent(share: float) -> str:
    """Return a fraction as a percentage with two digits."""
    number = two_digits(100.0 * share) if share >= 1e-6 else power_of_ten(100.0 * share)
    return f"{number}\N{NO-BREAK SPACE}%"


def cheapest_good(rows: Sequence[LensRow]) -> LensRow | None:
    """Return the row with the fewest triangles and at most a tenth of a pixel of error."""
    good = [row for row in rows if row.rms_px <= GOOD_PIXELS]
    return min(good, key=lambda row: row.triangles, default=None)


def cheapest_mesh(study: LensStudy, way: str = LENS_ALONE) -> LensRow | None:
    """Return the coarsest row within a tenth of a pixel that needs no formula of the surface; in a tie, the best."""
    good = [row for level in MESH_LEVELS if (row := cheapest_good(study.of(way, level)))]
    return min(good, key=lambda row: row.triangles, default=None)


def about_the_truth(study: LensStudy) -> str:
    """Describe the uncertainty of the truth."""
    if study.truth_error_mm is None:
        return (
            "The truth is a trace through the analytic surfaces in float64; its own rounding error could not be "
            "measured here, because this machine's long double is no wider."
        )
    return (
        "The truth is a trace through the analytic surfaces in float64 that shares no code with the tracer; the same "
        f"trace in extended precision lands within {length(study.truth_error_mm)} of it."
    )


def about_triangles(study: LensStudy, way: str) -> str:
    """Describe how each level's error falls with the mesh, and recommend one."""
    exact = study.of(way, "exact")
    sentences = [_choice(study, way, exact[0])]
    describe = _level_words if way == LENS_ALONE else _level_words_through_lenslets
    sentences += [describe(study, way, level) for level in LEVELS if level != "exact" and study.of(way, level)]
    if way != LENS_ALONE:
        sentences.append(
            f"The curved face of a lenslet has {study.lenslet_triangles:,} triangles on every mesh of the lens: its "
            "own error is the remaining error of patch and smooth."
        )
    return " ".join(sentences)


def about_time(study: LensStudy, way: str) -> str:
    """Describe the levels' cost in time, memory and building, and any losses."""
    rows = study.of(way)
    exact = study.of(way, "exact")[0]
    words = [f"On its default mesh exact takes {_nanoseconds(exact)} per event."]
    for level in MESH_LEVELS:
        if good := cheapest_good(study.of(way, level)):
            ratio = exact.events_per_second / good.events_per_second
            pace = "as long" if 1 / TIE <= ratio <= TIE else f"{two_digits(ratio)} times as long"
            words.append(f"The coarsest {level} mesh below a tenth of a pixel takes {pace} ({_nanoseconds(good)}).")
            break
    fastest = max(rows, key=lambda row: row.events_per_second)
    if fastest.events_per_second <= TIE * exact.events_per_second:
        words.append("No level on any mesh is clearly faster than exact: giving up accuracy buys no time.")
    else:
        words.append(
            f"The fastest of all is {fastest.surface} with {fastest.triangles:,} triangles, {_nanoseconds(fastest)} "
            f"per event, at an error of {length(fastest.rms_mm)}."
        )
    finest = max(rows, key=lambda row: row.triangles)
    words.append(
        f"Exact's default mesh takes {two_digits(exact.build_seconds)} s to build and "
        f"{two_digits(exact.table_bytes / 1e6)} MB of tables; {finest.triangles:,} triangles per surface take "
        f"{two_digits(finest.build_seconds)} s and {two_digits(finest.table_bytes / 1e6)} MB."
    )
    return " ".join([*words, *_what_went_wrong(rows)])


def about_images(study: ImageStudy) -> str:
    """Describe the most efficient way to estimate an image, and its lead."""
    ranked = _ranked(study)
    words = [most_efficient(study)]
    if SOBOL in ranked and RANDOM in ranked:
        at = study.of(SOBOL)[-1].samples
        words.append(
            f"In a typical pixel, at {at} samples, Sobol' points are worth "
            f"{study.typical_gain(SOBOL, RANDOM):.2f} times as many random ones."
        )
    forward = [way for way in ranked if way.method == "forward" and way is not ANALOG]
    if forward and ANALOG in ranked:
        words.append(
            f"For light that must be traced forward choose {forward[0].name}: it is "
            f"{_factor(*study.gain(forward[0], ANALOG))} times as efficient as analog."
        )
    return " ".join(words)


def about_image_time(study: ImageStudy) -> str:
    """Describe the time cost of an error, and the reference's uncertainty."""
    best = _ranked(study)[0]
    tenth = 1.0 / (study.efficiency(best) * 0.1**2)
    return (
        f"To halve an error takes four times the time, with Sobol' points a little less. An rms error of 10 % costs "
        f"{best.name} {two_digits(tenth)} s of one core. " + about_the_reference(study)
    )


def most_efficient(study: ImageStudy) -> str:
    """Describe the most efficient way and its lead; ties are stated, and broken by the typical error."""
    ranked = _ranked(study)
    best = ranked[0]
    words = f"the most efficient way is {best.name}, at {two_digits(study.efficiency(best))} / s"
    even = [way for way in ranked[1:] if not _is_surely_better(study, best, way)]
    if even:
        tied = " and ".join(way.name for way in even)
        words += f", indistinguishable from {tied} by its rms error, but better in a typical pixel"
    others = [
        f"{_factor(*study.gain(best, way))} times as efficient as {way.name}" for way in ranked[1:] if way not in even
    ]
    return _sentence(f"{words}; it is {', '.join(others)}" if others else words)


def about_the_reference(study: ImageStudy) -> str:
    """Describe the reference's uncertainty and its influence."""
    words = (
        f"The reference, adjoint with {study.reference_samples} samples per pixel and another seed, has an rms error "
        f"of {percent(study.reference_error)} itself ({percent(study.reference_typical)} in a typical pixel); its "
        f"variance is {percent(study.reference_share())} of the smallest measured, and subtracted."
    )
    if study.binned > 1:
        words += (
            f" Measured with {study.binned} × {study.binned} pixels of the sensor joined into one "
            f"({study.pixels[0]} × {study.pixels[1]} in all), so that the inefficient ways converge at all."
        )
    return words


def lens_summary(study: LensStudy) -> dict[str, str]:
    """Return a lens as one row of a table."""
    exact = study.of(LENS_ALONE, "exact")[0]
    needed = {
        level: f"{row.triangles:,}" if (row := cheapest_good(study.of(LENS_ALONE, level))) else "none measured"
        for level in MESH_LEVELS
    }
    return {
        "lens": study.name,
        "exact: triangles": f"{exact.triangles:,}",
        "exact: max error": length(exact.max_mm),
        **{f"{level}: triangles for 0.1 pixels": count for level, count in needed.items()},
    }


def three_numbers(study: LensStudy) -> list[str]:
    """Return the most important numbers of a lens, up to three, one line each."""
    exact = study.of(LENS_ALONE, "exact")[0]
    lines = [
        f"exact, {exact.triangles:,} triangles per surface (its default): rays land within {length(exact.max_mm)} of "
        f"the truth, {_nanoseconds(exact)} per event"
    ]
    mesh = cheapest_mesh(study)
    if mesh is not None:
        lines.append(
            f"{mesh.surface}, for glass that is only a mesh: {mesh.triangles:,} triangles per surface err by "
            f"{pixels(mesh.rms_px)} (rms)"
        )
    if facets := study.of(LENS_ALONE, "flat"):
        flat = facets[-1]
        lines.append(f"flat facets, {flat.triangles:,} triangles per surface: {pixels(flat.rms_px)} off (rms)")
    return lines


def _choice(study: LensStudy, way: str, exact: LensRow) -> str:
    words = (
        f"Choose exact wherever the surfaces have a formula: on its default mesh of {exact.triangles:,} triangles per "
        f"surface rays land within {length(exact.max_mm)} of the truth, and finer meshes change nothing. "
    )
    if not any(study.of(way, level) for level in MESH_LEVELS):
        return words.rstrip()
    mesh = cheapest_mesh(study, way)
    if mesh is None:
        return words + "For glass that is only a mesh, no mesh measured stays below a tenth of a pixel."
    if way != LENS_ALONE:
        return words + f"For glass that is only a mesh choose {mesh.surface}."
    return words + (
        f"For glass that is only a mesh choose {mesh.surface}: {mesh.triangles:,} triangles per surface stay below a "
        "tenth of a pixel."
    )


def _level_words(study: LensStudy, way: str, level: str) -> str:
    rows = study.of(way, level)
    first, last = rows[0], rows[-1]
    return (
        f"With {level} the rms error falls with order {order_of(rows):.1f} in the size of the facets, from "
        f"{length(first.rms_mm)} at {first.triangles:,} triangles to {length(last.rms_mm)} ({pixels(last.rms_px)}) at "
        f"{last.triangles:,}."
    )


def _level_words_through_lenslets(study: LensStudy, way: str, level: str) -> str:
    rows = study.of(way, level)
    first, last = rows[0], rows[-1]
    return (
        f"With {level} {percent(first.elsewhere)} of the rays come through the wrong lenslet at "
        f"{first.triangles:,} triangles, {percent(last.elsewhere)} at {last.triangles:,}, where the others err by "
        f"{length(last.rms_mm)} ({pixels(last.rms_px)})."
    )


def _what_went_wrong(rows: Sequence[LensRow]) -> list[str]:
    """Describe losses and stray rays, if any, and their cause."""
    words = []
    lost = max(rows, key=lambda row: row.lost)
    if lost.lost > 0.0:
        words.append(
            f"At most {percent(lost.lost)} of the power was lost, by {lost.surface} with {lost.triangles:,} triangles: "
            "meshes so coarse cross their neighbours in thin gaps."
        )
    else:
        words.append("No power was lost.")
    exact = max((row for row in rows if row.surface == "exact"), key=lambda row: row.astray)
    if exact.astray > 0.0:
        words.append(
            f"With exact on {exact.triangles:,} triangles {percent(exact.astray)} of the rays do not end where they "
            "should: they graze the rim of a steep surface, and pass between it and the chord of its mesh."
        )
    return words


def _ranked(study: ImageStudy) -> list[Way]:
    """Return the ways, the most efficient first.

    Errors below the reference's come first. Among ways not distinguished from the first by their mean square, the one
    with the least typical error for its time takes the first place.
    """
    ways = [way for way in WAYS if study.of(way)]
    ranked = sorted(ways, key=lambda way: -study.efficiency(way) if study.efficiency(way) > 0.0 else -math.inf)
    even = [way for way in ranked if way is ranked[0] or not _is_surely_better(study, ranked[0], way)]
    best = min(even, key=lambda way: study.of(way)[-1].typical ** 2 * study.of(way)[-1].seconds)
    return [best, *(way for way in ranked if way is not best)]


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}."


def _is_surely_better(study: ImageStudy, best: Way, way: Way) -> bool:
    ratio, error = study.gain(best, way)
    return ratio - 1.0 > SURE * error


def _nanoseconds(row: LensRow) -> str:
    return f"{1e9 / row.events_per_second:,.0f}\N{NO-BREAK SPACE}ns"


def _factor(ratio: float, error: float) -> str:
    """Return a ratio with as many digits as its error allows."""
    if not math.isfinite(error) or error <= 0.0:
        return two_digits(ratio)
    digits = -math.floor(math.log10(error))
    return f"{round(ratio, digits):,.{max(0, digits)}f} ± {round(error, digits):,.{max(0, digits)}f}"
