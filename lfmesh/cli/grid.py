"""Flow fields as voxel grids: `lfmesh grid`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.printing import list_files
from lfmesh.errors import LfmeshError
from lfmesh.view.progress import status
from lfmesh.wrapping import wrapped

if TYPE_CHECKING:
    from lfmesh.imports.flow_grid import FlowArray

Triple = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]


@app.command(
    help_epilogue="""\
More examples:

    lfmesh grid flow.vtu -o flow.vti --units m --spacing-mm 1 1 1 \\
      --array T=temperature_k --array p=pressure_kpa --factor p=0.001
    lfmesh grid flow.cgns -o flow.vti --units mm --spacing-mm 1 1 2 \\
      --array Density=density_kg_m3 --fill Density=1.2 \\
      --bounds-mm -20 20 -20 20 0 100
"""
)
def grid(
    flow: Annotated[Path, Parameter(help="Flow field: an OpenFOAM case (.foam), a VTK or CGNS file, ...")],
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Voxel grid to write: .vti, in mm.")],
    spacing_mm: Annotated[Triple, Parameter(help="Size of the voxels along x, y and z, mm.")],
    array: Annotated[
        list[str] | None,
        Parameter(help="NAME=QUANTITY: an array and its quantity, such as T=temperature_k; may be repeated."),
    ] = None,
    factor: Annotated[
        list[str] | None, Parameter(help="NAME=NUMBER: multiplies an array, such as p=0.001 for Pa to kPa.")
    ] = None,
    fill: Annotated[
        list[str] | None, Parameter(help="NAME=NUMBER: value of an array's quantity outside the cells of the file.")
    ] = None,
    units: Annotated[str | None, Parameter(help="Unit of length of the file; .foam is in m.")] = None,
    bounds_mm: Annotated[
        Six | None,
        Parameter(help="Lowest and highest x, y, z of the voxels' centres, mm (default: the whole flow)."),
    ] = None,
    time_s: Annotated[float | None, Parameter(help="Time of the flow, s (default: the last).")] = None,
) -> int:
    """Resample a flow field of a simulation onto a voxel grid for a medium, and print the error of the resampling.

    The error is the difference between the file and the grid, interpolated as in a render, on a grid twice as fine.
    Without --array, arrays named as a grid's quantities are taken.
    """
    if out.suffix.lower() != ".vti":
        raise LfmeshError(f"{out}: a voxel grid is written as VTK image data; give a name that ends in .vti")
    with defer_interrupt():
        from lfmesh.files.folder import staged_file
        from lfmesh.imports.flow_grid import Resampling, resampled, vti_bytes
    wanted = Resampling(spacing_mm, units, bounds_mm, time_s)
    with status() as report:
        report("resampling")
        found = resampled(flow, _arrays(array or [], factor or [], fill or []), wanted)
    with staged_file(out.parent, out.name) as file:
        file.write(vti_bytes(found.grid))
    for line in found.lines():
        print(wrapped(line))
    list_files([out])
    return 0


def _arrays(names: list[str], factors: list[str], fills: list[str]) -> "tuple[FlowArray, ...]":
    """Return the arrays that --array, --factor and --fill describe."""
    from lfmesh.imports.flow_grid import FlowArray

    quantities = dict(_pair("array", text, "T=temperature_k") for text in names)
    by_factor = {name: _number("factor", name, text) for name, text in (_pair("factor", f, "p=0.001") for f in factors)}
    by_fill = {name: _number("fill", name, text) for name, text in (_pair("fill", f, "T=293") for f in fills)}
    for option, given in (("factor", by_factor), ("fill", by_fill)):
        if unknown := sorted(given.keys() - quantities.keys()):
            raise LfmeshError(f"--{option} {unknown[0]}: no --array has this name; give --array {unknown[0]}=QUANTITY")
    if len(set(quantities.values())) < len(names):
        raise LfmeshError("--array: two arrays give the same quantity, or one gives two; give one for each")
    return tuple(
        FlowArray(name, quantity, by_factor.get(name, 1.0), by_fill.get(name)) for name, quantity in quantities.items()
    )


def _pair(option: str, text: str, example: str) -> tuple[str, str]:
    name, sign, value = text.partition("=")
    if not (name and sign and value):
        raise LfmeshError(f"--{option} {text}: write two words with = between, such as {example}")
    return name, value


def _number(option: str, name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise LfmeshError(f"--{option} {name}={text}: must be a number") from None
