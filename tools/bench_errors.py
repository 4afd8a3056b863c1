"""The error that images report against the error that they have, on crops of the scenes in assets.

    tools/bench errors
    tools/bench errors --scene lytro_class --side 200 --json figures.json
    tools/bench errors --scene lytro_class --side 48 --at 0.9 0.2        the bracket's shaded side

For each number of samples and replicates: reported over true error, root mean square over root mean square, in groups
of pixels by what a long render shows (the smallest and the largest ratio) and in the four quarters of the reported
error; the noise line's quartiles beside the quartiles that the truth has; and how often the truth lies within 1, 2 and
3 standard errors of a pixel with 100 hits and noise of more than one, less what Student's t says, in points.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from bench_report import COLOURS, Report, Table, deliver, guarded, parser, say, whole

import lfmesh as lf
from lfmesh.accuracy.reported_error import CROPS, DIM_SHARE, Coverage, coverage, crop, error_ratios, study_errors
from lfmesh.assets import asset_path
from lfmesh.files import words

SAMPLES, REPLICATES = (8, 32, 128, 512), (2, 4, 8)
SIDE, REFERENCE = 96, 8192
QUICK_SIDE, QUICK_REFERENCE, QUICK_REPLICATES = 32, 512, (4,)

COLUMNS = {
    "scene": ("scene", ""),
    "samples": ("samples", "d"),
    "replicates": ("replicates", "d"),
    "least": ("least", ".2f"),
    "most": ("most", ".2f"),
    "quarters": ("by quarters of itself", ""),
    "says": ("line, %", ""),
    "is": ("true, %", ""),
    "warns": ("warns", ""),
    "dark": ("no hit", ",d"),
    "bound_fails": ("bound fails", ".1%"),
    "coverage": ("coverage, points off", ""),
}


@dataclass(frozen=True)
class Case:
    """Numbers of one image against its reference."""

    image: lf.Image
    reference: lf.Image

    def row(self, scene: str) -> dict[str, Any]:
        """Return a row of the table."""
        image, reference = self.image, self.reference
        assert image.hits is not None
        ratios = error_ratios(image, reference)
        shown = [r.ratio for r in ratios if not r.group.startswith("reported")]
        noise = words.noise(image)
        lit = reference.mean > DIM_SHARE * np.percentile(reference.mean, 99.0)
        relative = np.abs(image.mean - reference.mean)[lit] / reference.mean[lit]
        few = image.hits < 10
        # A standard error is 1.48 times the median of the errors that it makes.
        true = 1.4826 * np.median(relative)
        return {
            "scene": scene,
            "samples": image.scene.transport.samples,
            "replicates": image.scene.transport.replicates,
            "least": min(shown),
            "most": max(shown),
            "quarters": " ".join(f"{r.ratio:.2f}" for r in ratios if r.group.startswith("reported")),
            "says": " ".join(f"{100.0 * e:.2g}" for e in noise.relative_error or ()),
            "is": f"{100.0 * true:.2g}",
            "warns": "yes" if any("too few" in line for line in words.summary(image)) else "",
            "dark": noise.without_hits,
            "bound_fails": float((reference.mean > image.upper)[few].mean()) if few.any() else 0.0,
            "coverage": _coverage(coverage(image, reference)),
        }


def _coverage(found: list[Coverage]) -> str:
    return " ".join(f"{100.0 * (c.found - c.expected):+.1f}" for c in found if c.pixels)


def draw(rows: Sequence[dict[str, Any]], figure: Any) -> None:
    """Draw the smallest and the largest ratio of each case."""
    axes = figure.add_subplot()
    names = [f"{row['scene']} {row['samples']}/{row['replicates']}" for row in rows]
    for row, name in zip(rows, names, strict=True):
        axes.plot([row["least"], row["most"]], [name, name], color=COLOURS[0], marker="|")
    axes.axvspan(0.8, 1.25, alpha=0.2)
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="reported over true error, groups of pixels")


def main() -> None:
    own = parser("errors", "The error that images report against the error that they have.")
    own.add_argument("--scene", choices=sorted(CROPS), help="one of the scenes in assets; default: all of them")
    own.add_argument("--side", type=whole, help=f"pixels along each side of the crop; default {SIDE}")
    own.add_argument("--reference", type=whole, help=f"samples of the reference; default {REFERENCE}")
    own.add_argument("--at", nargs=2, type=float, metavar=("X", "Y"), help="middle of the crops, mm on the sensor")
    given = own.parse_args()
    side = given.side or (QUICK_SIDE if given.quick else SIDE)
    reference = given.reference or (QUICK_REFERENCE if given.quick else REFERENCE)
    samples = SAMPLES[:2] if given.quick else SAMPLES
    replicates = QUICK_REPLICATES if given.quick else REPLICATES
    rows = []
    for name in [given.scene] if given.scene else sorted(CROPS):
        scene = crop(lf.load(asset_path(f"scenes/{name}.toml")), side, tuple(given.at or CROPS[name]))
        rows += [Case(*pair).row(name) for pair in study_errors(scene, samples, replicates, reference, say)]
    report = Report("errors", {"side_px": side, "reference_samples": reference})
    report.tables["errors"] = Table("Reported over true error", COLUMNS, rows)
    deliver(report, given, partial(draw, rows))


if __name__ == "__main__":
    sys.exit(guarded(main))
