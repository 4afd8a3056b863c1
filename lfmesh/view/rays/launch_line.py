"""Launch of rays from a line of text, such as "field 0,0,-500"."""

import difflib
import re
from typing import Any

from lfmesh.errors import LfmeshError
from lfmesh.transport.world import World
from lfmesh.view.rays.launch import as_in_run, from_field_point, from_light, from_pixel, from_pixels
from lfmesh.view.rays.paths import Rays

FORMS = {
    "field": "field x,y,z        a point of object space, mm, world frame",
    "pixel": "pixel row,column   against the light",
    "pixels": "pixels r:r,c:c     a box of pixels, rows and columns as Python slices: the end is excluded",
    "light": "light number       one of the scene's lights",
    "run": "run                as the scene's transport.method launches them",
}
"""Forms that `launch` accepts, one line each."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"

_PATTERNS = {
    "field": rf"({_NUMBER}),({_NUMBER}),({_NUMBER})",
    "pixel": r"(-?\d+),(-?\d+)",
    "pixels": r"(-?\d+):(-?\d+),(-?\d+):(-?\d+)",
    "light": r"(-?\d+)",
    "run": "",
}


def launch(
    world: World,
    spec: str,
    count: int,
    *,
    wavelength_nm: float | None = None,
    split: str | None = None,
    weight_cutoff: float | None = None,
    seed: int | None = None,
) -> Rays:
    """Launch rays from a line of text: "field 0,0,-500", "pixel 320,310", "light 0", "run"; see `FORMS`.

    Parameters
    ----------
    world : World
    spec : str
    count : int
    wavelength_nm, split, weight_cutoff, seed : optional
        As for the corresponding function (default: as in a run of the scene).

    Raises
    ------
    LfmeshError
        The text has none of the forms, or as for the function.
    """
    kind, numbers = _read_spec(spec)
    transport = world.scene.transport
    split = transport.split if split is None else split
    seed = transport.seed if seed is None else seed
    more: dict[str, Any] = {
        "wavelength_nm": wavelength_nm, "split": split, "weight_cutoff": weight_cutoff, "seed": seed
    }  # fmt: skip
    if kind == "field":
        return from_field_point(world, [float(n) for n in numbers], count, **more)
    whole = [int(n) for n in numbers]
    if kind == "pixel":
        return from_pixel(world, whole[0], whole[1], count, **more)
    if kind == "pixels":
        return from_pixels(world, range(*whole[:2]), range(*whole[2:]), count, **more)
    return from_light(world, whole[0], count, **more) if kind == "light" else as_in_run(world, count, **more)


def _read_spec(spec: str) -> tuple[str, list[str]]:
    """Return the kind and numbers of a launch."""
    kind, _, rest = spec.strip().partition(" ")
    forms = "\n  ".join(FORMS.values())
    if kind not in FORMS:
        near = difflib.get_close_matches(kind, FORMS, 1)
        hint = f"; did you mean {near[0]!r}?" if near else "."
        raise LfmeshError(f"launch {spec!r}: unknown launch {kind!r}{hint} Valid are:\n  {forms}")
    found = re.fullmatch(_PATTERNS[kind], re.sub(r"\s+", "", rest))
    if not found:
        raise LfmeshError(f"launch {spec!r}: cannot be read; write\n  {FORMS[kind]}")
    return kind, list(found.groups())
