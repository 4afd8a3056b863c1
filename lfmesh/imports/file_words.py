"""Faults of a lens in terms of its source file rather than the keys of a scene."""

import re

from lfmesh.imports.prescription import FileSurface

_NOUNS = {
    "semi_diameter_mm": "clear semi-diameter, mm",
    "radius_mm": "radius, mm",
    "radius_x_mm": "radius in x, mm",
    "thickness_mm": "distance to the next surface, mm",
    "asphere_mm": "coefficients",
    "odd_asphere_mm": "odd coefficients",
    "norm_radius_mm": "norm radius, mm",
    "focal_length_mm": "focal length, mm",
}

_FAULT = re.compile(r"(?:Lens\.)?surfaces?(?:\[([0-9]+)\])?((?:\.\w+(?:\[[0-9]+\])*)*)", re.IGNORECASE)


def file_fault(said: str, kept: list[FileSurface], number: int | None = None) -> str:
    """Return the first fault of a scene's lens with the file's line, without advice on scene keys.

    Parameters
    ----------
    said : str
        Message of the scene, one fault per line.
    kept : list of FileSurface
        The file's surfaces, in the order of the lens.
    number : int, optional
        Number of the faulty surface, if not in the message.
    """
    fault = next((line.strip() for line in said.splitlines() if _FAULT.match(line.strip())), said)
    found = _FAULT.match(fault)
    if found is not None and found[1] is not None:
        number = int(found[1])
    fault = re.sub(r"; (give|omit|add) .*|: (omit|give) .*$", "", fault[found.end() :] if found else fault)
    key = found[2].strip(".") if found else ""
    fault = f"{key}{fault}" if fault.startswith(" =") else fault.removeprefix(": ")
    for name, noun in _NOUNS.items():
        fault = re.sub(rf"\b{name}\b", noun, fault)
    if number is None or not 0 <= number < len(kept):
        return f"as a lens of this program: {fault}"
    surface = kept[number]
    # Files without lines have line number 0.
    place = f"line {surface.line}: " if surface.line else ""
    return f"{place}{surface.text or 'surface'}: surface {number} of the lens: {fault}"
