"""Parameters shared by commands: scene file, run folder, settings that replace the scene's."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import cyclopts
from cyclopts import Parameter

from lfmesh.errors import LfmeshError, SceneError

if TYPE_CHECKING:
    from lfmesh.scene import Scene


def _whole(_: object, tokens: Sequence[cyclopts.Token]) -> int:
    """Read a whole number; cyclopts alone would truncate 4.5 to 4."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f'"{tokens[0].value}" is not a whole number') from None


Whole = Annotated[int, Parameter(converter=_whole, n_tokens=1)]

SceneFile = Annotated[Path, Parameter(name="scene", help="Scene file (TOML).")]
Dask = Annotated[
    str | None, Parameter(help='Run on the workers of a dask cluster: the address of its scheduler, or "local".')
]
Shard = Annotated[str | None, Parameter(help="Do only one share of the work, such as 1/3, 2/3 or 3/3.")]
Verbose = Annotated[
    bool, Parameter(help="Also print how well the light is aimed, the blur by diffraction, and the work done.")
]
RunFolder = Annotated[Path, Parameter(name="run", help="Run folder of a light-field camera, from lfmesh render.")]


def share_of(text: str | None) -> tuple[int, int] | None:
    """Read the number and the count of shares, such as "1/3"."""
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    if found is not None and int(found[1]) > int(found[2]):
        raise LfmeshError(f"--shard {text}: there is no share {found[1]} of {found[2]}; write the number first: 1/3")
    if found is None or int(found[1]) < 1:
        raise LfmeshError(f'--shard {text}: give the share\'s number and the number of shares, such as "1/3"')
    return int(found[1]), int(found[2])


@Parameter(name="*")
@dataclass
class Overrides:
    """Settings that override the scene's [transport] table."""

    samples: Annotated[
        Whole | None, Parameter(help="Total samples per pixel; 4 times as many at least halve the noise.")
    ] = None
    target_error: Annotated[
        float | None,
        Parameter(help="Give noisy pixels more samples until their relative standard error is this, such as 0.05."),
    ] = None
    max_samples: Annotated[Whole | None, Parameter(help="With --target-error: largest total of samples per pixel.")] = (
        None
    )
    method: Annotated[
        Literal["adjoint", "forward"] | None,
        Parameter(help="adjoint: from the sensor to the light; forward: from the light to the sensor."),
    ] = None
    engine: Annotated[
        Literal["auto", "mesh", "sequential"] | None,
        Parameter(
            help="mesh: Embree, everything; sequential: the image path only; auto: the fastest that supports the scene."
        ),
    ] = None
    surface: Annotated[
        Literal["exact", "flat", "smooth", "patch"] | None,
        Parameter(help="Tracing of the lens's facets: exact surface, flat, smooth normals, or curved patch."),
    ] = None
    split: Annotated[
        Literal["both", "roulette", "transmit"] | None,
        Parameter(help="At an interface: follow both children, one by chance, or the refracted one."),
    ] = None
    diffraction: Annotated[
        Literal["none", "lenslets", "stop"] | None,
        Parameter(
            help="Trace diffraction at each lenslet's aperture, at the stop of a camera without an array, or not at "
            "all."
        ),
    ] = None
    replicates: Annotated[
        Whole | None,
        Parameter(
            help="Independent parts of the samples, whose spread gives the standard error (default: the scene's, "
            "else 8, or 4 with split transmit)."
        ),
    ] = None
    seed: Annotated[Whole | None, Parameter(help="Seed of the random numbers.")] = None
    threads: Annotated[
        Whole | None, Parameter(help="Number of threads; 0 uses all cores. The result does not depend on it.")
    ] = None
    wavelengths_nm: Annotated[
        list[float] | None, Parameter(help="One or more wavelengths, nm.", consume_multiple=True)
    ] = None

    def given(self) -> dict[str, Any]:
        """Return the settings that the user gave."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value is not None}


def overridden(scene: "Scene", overrides: Overrides | None) -> "Scene":
    """Return the scene with other transport settings, validated like a scene file's."""
    changes = overrides.given() if overrides else {}
    try:
        changed = scene.changed({f"transport.{name}": value for name, value in changes.items()})
    except SceneError as error:
        raise SceneError(_as_options(str(error))) from None
    if "max_samples" in changes and changed.transport.target_error is None:
        raise SceneError(
            f"--max-samples = {changes['max_samples']}: has no effect without --target-error; give both, or "
            "--samples alone"
        )
    return changed


def as_option(field: str) -> str:
    """Return the option that sets a field."""
    return "--" + field.replace("_", "-")


def _as_options(message: str) -> str:
    """Replace the fields that a message names by the options that set them."""
    return re.sub(
        r"^Scene\.transport\.(\w+)",
        lambda field: as_option(field[1]),
        message,
        flags=re.MULTILINE,
    )
