"""Title block of a layout drawing: the camera's first-order figures, at the foot of the sheet."""

import math

import numpy as np

from lfmesh.optics.glass import AIR
from lfmesh.scene.first_order.lenslets import LensletSection
from lfmesh.scene.first_order.solve import lenslet_focal_length_mm
from lfmesh.scene.literals import counted
from lfmesh.view.layout.content import Layout
from lfmesh.view.layout.sheet import LEAST_TEXT, Sheet, length_in_words
from lfmesh.view.style import GREY


def title_block(sheet: Sheet, drawn: Layout, x: float, y: float, width: float, height: float) -> None:
    """Write the table of first-order figures.

    Parameters
    ----------
    sheet : Sheet
    drawn : Layout
    x, y : float, inches
        Lower left corner.
    width, height : float, inches
    """
    rows = _facts(drawn)
    tall = height / len(rows)
    for i, row in enumerate(rows):
        base = y + height - (i + 1) * tall
        sheet.line([x, x + width], [base + tall] * 2, lw=0.5)
        shares = np.cumsum([0.0, *(share for share, *_ in row)]) / sum(share for share, *_ in row)
        for (_, name, value), left, right in zip(row, shares, shares[1:], strict=False):
            start, room = x + left * width, (right - left) * width - 0.16
            sheet.text(start + 0.08, base + tall - 0.14, name, LEAST_TEXT + 1.0, color=GREY)
            words, size = sheet.fitted(value, room)
            sheet.text(start + 0.08, base + 0.08, words, size)
            if left > 0.0:
                sheet.line([start, start], [base, base + tall], lw=0.5)


def _facts(drawn: Layout) -> list[list[tuple[float, str, str]]]:
    """Return the cells of the title block: fraction of the width, name, value."""
    scene, facts = drawn.scene, drawn.facts
    camera, mla, sensor = scene.camera, scene.camera.mla, scene.camera.sensor
    full = drawn.bundles[-1].slope
    pupil = facts.entrance_pupil_z_mm if math.isfinite(facts.entrance_pupil_z_mm) else 0.0
    real = 0.0 < drawn.distance_mm < math.inf
    angle = math.degrees(math.atan(full * drawn.distance_mm / (drawn.distance_mm + pupil) if real else full))
    size = f"±{abs(full * drawn.distance_mm):.4g} mm, " if real else ""
    focus = "infinity" if math.isinf(drawn.distance_mm) else length_in_words(drawn.distance_mm, 5)
    medium = f" in n = {facts.object_index:.4g}" if facts.object_index != AIR else ""
    first = [
        (2.4, "lens", camera.lens.name or counted(len(camera.lens.surfaces), "surface")),
        (1.2, "effective focal length", f"{facts.efl_mm:.5g} mm"),
        (1.0, "working f-number", f"f/{facts.working_f_number:.3g}"),
        (1.2, "plane in focus", f"{focus}{medium}"),
        (1.8, "field in y", f"{size}±{abs(angle):.3g}°"),
        (1.0, "magnification", f"{facts.magnification:.4g}".replace("-", "−")),
        (1.0, "wavelength", f"{facts.wavelength_nm:g} nm"),
    ]
    around = f" in n = {facts.image_index:.4g}" if facts.image_index != AIR else ""
    pixels = f"{sensor.pixels[0]} × {sensor.pixels[1]} pixels of {length_in_words(sensor.pixel_mm)}{around}"
    if mla is None:
        return [first, [(4.0, "microlens array", "none: a conventional camera"), (4.0, "sensor", pixels)]]
    curved = any(map(math.isfinite, mla.radii_mm))
    profile = f" {mla.profile_words}," if mla.profile_words else ", curved side" if curved else ", diffractive side"
    focal = ", ".join(f"{f:.4g}" for f in lenslet_focal_length_mm(camera, facts.wavelength_nm))
    shape = ", both faces curved" if mla.has_back else f"{profile} to the {mla.curved_side}"
    if mla.gradient is not None:
        shape = f"{shape if mla.has_back or curved else ', plane faces'}, gradient-index"
    micro = number = "none"
    if facts.microlens_f_number is not None:
        micro = f"{facts.micro_image_diameter_px:.3g} px, every {facts.micro_image_pitch_px:.5g} px"
        number = f"f/{facts.microlens_f_number:.3g}"
    if len(facts.lenslet_sections) > 1:
        bent = [at for at in facts.lenslet_sections if at.f_number is not None]
        number = ", ".join(f"{at.section}: f/{at.f_number:.3g}" for at in bent)
        micro = ", ".join(f"{at.section}: {_micro_image(at)}" for at in facts.lenslet_sections)
        focal = ", ".join(f"{at.section}: {at.focal_length_mm:.4g}" for at in facts.lenslet_sections)
    second = [
        (2.4, "microlens array", f"{mla.count[0]} × {mla.count[1]} {mla.layout}{shape}"),
        (1.2, "pitch", length_in_words(mla.pitch_mm)),
        (1.8, "lenslet focal length", f"{focal} mm"),
        (1.0, "lenslet f-number", number),
        (1.4, "micro-image", micro),
        (2.2, "sensor", pixels),
    ]
    return [first, second]


def _micro_image(at: LensletSection) -> str:
    """Format the width of a micro-image in one section of the lenslets."""
    return "a line" if at.micro_image_diameter_px is None else f"{at.micro_image_diameter_px:.3g} px"
