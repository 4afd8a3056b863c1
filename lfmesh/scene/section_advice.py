"""Warnings about lenses that first-order optics in the sections along x and y does not fully describe."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lfmesh.optics.glass import Medium, refractive_index
from lfmesh.scene.camera.phase import Phase
from lfmesh.scene.first_order.lenslets import LONGEST_LINE, line_share
from lfmesh.scene.first_order.relay import FOCUSED_BLUR_PX
from lfmesh.scene.scene import Scene

if TYPE_CHECKING:
    from lfmesh.scene.first_order.report import FirstOrder


def section_warnings(scene: Scene, facts: "FirstOrder") -> Iterator[str]:
    """Yield the warnings about a solved scene.

    Parameters
    ----------
    scene : Scene
    facts : FirstOrder
    """
    yield from _between_sections(scene)
    yield from _sections(facts)
    yield from _lenslets(scene)


def _between_sections(scene: Scene) -> Iterator[str]:
    """Warn of surfaces that the x and y sections do not fully describe."""
    media = scene.camera.lens.media
    for i, surface in enumerate(scene.camera.lens.surfaces):
        turn = _turn_deg(surface.phase, scene.primary_nm, media[i + 1]) if surface.phase is not None else 0.0
        if turn:
            yield (
                f"the phase of surface {i} turns light on the axis by {turn:.4g} degrees. First-order figures ignore "
                "this turn, and light may fall beside apertures, array and sensor"
            )
        if surface.gradient is not None and surface.gradient.turns_axis:
            yield (
                f"the gradient behind surface {i} turns light on the axis. First-order figures ignore this turn, and "
                "light may fall beside apertures, array and sensor"
            )
        if not surface.is_symmetric:
            parts = {"the phase of": surface.phase, "the gradient behind": surface.gradient}
            part = next((words for words, each in parts.items() if each is not None and not each.symmetric), None)
            key = surface.section_key
            which = f"{part} surface {i} is" if key is None else f"surface {i} is a {key},"
            yield (
                f"{which} not symmetric about x and y. First-order figures and "
                "omitted clear apertures are computed from the sections along x and y only. Light between them may "
                "focus elsewhere, or be cut off"
            )


def _turn_deg(phase: Phase, wavelength_nm: float, behind: Medium) -> float:
    """Return the angle by which a phase turns light along the axis; 90 for an evanescent order."""
    change = phase.path_per_rad_mm(wavelength_nm) * math.hypot(*phase.gradient_rad_mm)
    return math.degrees(math.asin(min(abs(change) / refractive_index(behind, wavelength_nm), 1.0)))


def _sections(facts: "FirstOrder") -> Iterator[str]:
    """Warn of a lens that has different power in x and y, and of its astigmatism."""
    if facts.efl_x_mm is None or facts.image_x_shift_mm is None:
        return
    in_y, in_x = (
        f"{length:.5g} mm" if math.isfinite(length) else "infinite" for length in (facts.efl_mm, facts.efl_x_mm)
    )
    if in_x != in_y:
        yield (
            f"the lens is anamorphic: its focal length is {in_y} in y and {in_x} in x; first-order figures, "
            "decoding, refocusing and depth use the one in y"
        )
    # Blur of a point in x; below the width of the Airy disk it is invisible.
    ratio = facts.image_index * facts.working_f_number
    blur = abs(facts.image_x_shift_mm) / ratio if ratio else math.inf
    if blur > facts.airy_disk_mm:
        side = "behind" if facts.image_x_shift_mm > 0 else "before"
        yield (
            "the lens is astigmatic: the plane in focus in y has its image in x "
            f"{abs(facts.image_x_shift_mm):.4g} mm {side} the array or sensor"
        )


def _lenslets(scene: Scene) -> Iterator[str]:
    """Warn of lenslets with a little different power in two sections, which are decoded as if they had one."""
    mla, share = scene.camera.mla, line_share(scene.camera, scene.primary_nm)
    pixels = share * mla.pitch_mm / scene.camera.sensor.pixel_mm if mla is not None else 0.0
    if pixels > FOCUSED_BLUR_PX and share <= LONGEST_LINE:
        yield (
            f"the lenslets are astigmatic: a point of the pupil in focus in one section is {pixels:.3g} pixels long in "
            "the other. Views, refocusing and depth are blurred as much"
        )
