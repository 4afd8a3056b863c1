"""Options of `lfmesh view`, in groups."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from lfmesh.cli.options import Whole


@Parameter(name="*")
@dataclass(frozen=True)
class Launches:
    """Options for the rays that start."""

    rays: Annotated[
        list[str] | None,
        Parameter(
            help='"field x,y,z", "pixel row,column", "pixels r:r,c:c", "light number", "run" or "none"; may be '
            "repeated. Omitted: points of the plane in focus, refracted rays alone.",
        ),
    ] = None
    count: Annotated[Whole | None, Parameter(help="Rays of each launch.")] = None
    wavelength_nm: Annotated[float | None, Parameter(help="Of all rays; those of the scene, if omitted.")] = None
    split: Annotated[
        Literal["both", "roulette", "transmit"] | None,
        Parameter(help="At an interface: follow both children, one by chance, or the refracted one."),
    ] = None
    weight_cutoff: Annotated[
        float | None,
        Parameter(help="Weaker rays are ended at random, without bias; 1e-4 follows two-reflection ghosts."),
    ] = None


@Parameter(name="*")
@dataclass(frozen=True)
class Selection:
    """Options for the paths that are drawn and reported."""

    filter: Annotated[
        str | None, Parameter(help='Paths to draw and report: "hits(mla) and not ghost", "reflects(L3b)", ...')
    ] = None
    path: Annotated[Whole | None, Parameter(help="The one to draw and report, by its number in the table.")] = None

    @property
    def expression(self) -> str | None:
        """Filter that combines both; None if every path is wanted."""
        if self.path is None:
            return self.filter
        numbered = f"path == {self.path}"
        return numbered if self.filter is None else f"({self.filter}) and {numbered}"


@Parameter(name="*")
@dataclass(frozen=True)
class Looks:
    """Options for drawing scene and rays."""

    colour: Annotated[
        Literal["wavelength", "power", "events", "status", "path", "field"] | None,
        Parameter(help="What the rays' colours mean: wavelengths, or where there is one, field points."),
    ] = None
    fade: Annotated[bool, Parameter(help="Draw rays with less power fainter.")] = False
    preset: Annotated[
        Literal["whole", "side", "object", "lens", "array", "sensor"], Parameter(help="Where to look from.")
    ] = "whole"
    cut: Annotated[bool, Parameter(help="Cut lens and array along the axis; rays stay whole.")] = False
    size: Annotated[str, Parameter(help="Of window and picture, in pixels.")] = "1600x1000"
    segments: Annotated[
        Whole, Parameter(help="Of rays, drawn at most; beyond that whole paths are left out, evenly.")
    ] = 20_000


@Parameter(name="*")
@dataclass(frozen=True)
class Reports:
    """Options for reports on rays without a drawing: a table of paths, printed or as CSV; a figure of ghosts."""

    table: Annotated[bool, Parameter(help="Print the path table.")] = False
    paths: Annotated[Path | None, Parameter(help="CSV to write the path table to.")] = None
    ghosts: Annotated[
        Path | None,
        Parameter(
            help="Figure to write: ghosts by pair of reflecting surfaces; of field points the strongest are printed."
        ),
    ] = None

    def __bool__(self) -> bool:
        return self.table or self.paths is not None or self.ghosts is not None


@Parameter(name="*")
@dataclass(frozen=True)
class Files:
    """Files that the drawing is written to, in place of a window."""

    screenshot: Annotated[Path | None, Parameter(help="PNG to write, in place of a window.")] = None
    html: Annotated[Path | None, Parameter(help="Page to write that turns in any browser, without a network.")] = None
    gltf: Annotated[Path | None, Parameter(help="3D model to write (.glb).")] = None


@Parameter(name="*")
@dataclass(frozen=True)
class Serving:
    """Options for serving the browser's page."""

    browser: Annotated[bool, Parameter(help="Show it on a page in the browser, with much more.")] = False
    host: Annotated[str, Parameter(help="With --browser: the address that the page is served on.")] = "127.0.0.1"
    port: Annotated[Whole, Parameter(help="With --browser; 0: a free one.")] = 0
    open_browser: Annotated[
        bool, Parameter(name="--open", negative="--no-open", help="With --browser: open the page in a browser.")
    ] = True
