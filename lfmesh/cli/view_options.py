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
            "repeated. Default: points of the plane in focus, refracted rays only.",
        ),
    ] = None
    count: Annotated[Whole | None, Parameter(help="Number of rays per launch.")] = None
    wavelength_nm: Annotated[float | None, Parameter(help="Wavelength of all rays, nm (default: the scene's).")] = None
    split: Annotated[
        Literal["both", "roulette", "transmit"] | None,
        Parameter(help="At an interface: follow both children, one by chance, or the refracted one."),
    ] = None
    weight_cutoff: Annotated[
        float | None,
        Parameter(help="End rays weaker than this at random, without bias; 1e-4 follows two-reflection ghosts."),
    ] = None


@Parameter(name="*")
@dataclass(frozen=True)
class Selection:
    """Options for the paths that are drawn and reported."""

    filter: Annotated[
        str | None, Parameter(help='Paths to draw and report: "hits(mla) and not ghost", "reflects(L3b)", ...')
    ] = None
    path: Annotated[Whole | None, Parameter(help="Number of the path in the table, to draw and report it alone.")] = (
        None
    )

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
        Parameter(
            help="Meaning of the rays' colours (default: wavelength, or field point if there is one wavelength)."
        ),
    ] = None
    fade: Annotated[bool, Parameter(help="Draw rays with less power fainter.")] = False
    preset: Annotated[Literal["whole", "side", "object", "lens", "array", "sensor"], Parameter(help="Viewpoint.")] = (
        "whole"
    )
    cut: Annotated[bool, Parameter(help="Cut lens and array along the axis; rays stay whole.")] = False
    size: Annotated[str, Parameter(help="Size of window and picture, in pixels.")] = "1600x1000"
    segments: Annotated[
        Whole, Parameter(help="Largest number of ray segments drawn; above it, evenly chosen paths are left out.")
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
            help="Figure to write: ghosts by pair of reflecting surfaces. For field points, prints the strongest."
        ),
    ] = None

    def __bool__(self) -> bool:
        return self.table or self.paths is not None or self.ghosts is not None


@Parameter(name="*")
@dataclass(frozen=True)
class Files:
    """Files that the drawing is written to, in place of a window."""

    screenshot: Annotated[Path | None, Parameter(help="PNG to write, in place of a window.")] = None
    html: Annotated[Path | None, Parameter(help="Interactive 3D page to write, for any browser, offline.")] = None
    gltf: Annotated[Path | None, Parameter(help="3D model to write (.glb).")] = None


@Parameter(name="*")
@dataclass(frozen=True)
class Serving:
    """Options for serving the browser's page."""

    browser: Annotated[bool, Parameter(help="Open an interactive page in the browser, with more tools.")] = False
    host: Annotated[str, Parameter(help="With --browser: address to serve the page on.")] = "127.0.0.1"
    port: Annotated[Whole, Parameter(help="With --browser: port; 0 takes a free one.")] = 0
    open_browser: Annotated[
        bool, Parameter(name="--open", negative="--no-open", help="With --browser: open the page in a browser.")
    ] = True
