"""Dataset file: a template scene, and the quantities drawn for each item."""

import glob
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from lfmesh.scene.model import Fault, Model, nearest
from lfmesh.scene.quantities import Count, Flag, Number, Positive, Text, Whole
from lfmesh.study.sweeps.axes import Axis, is_number
from lfmesh.study.sweeps.study_file import read_tables

WAYS = ("values", "files", "uniform", "log_uniform", "normal")
"""Keys of a draw for its distribution."""

PARTS = ("white", "views", "depth", "camera")
"""Parts of an item besides its raw image."""


class Draw(Model):
    """A field of the scene that is drawn anew for every item."""

    path: Text
    """The field, such as "targets[0].position_mm[2]"."""
    values: tuple[Any, ...] | None = None
    """Values, each as likely as the others: numbers, names, lists, as the field takes them."""
    files: Text | None = None
    """A folder, or a pattern such as "meshes/*.stl", relative to this file: its files, each as likely as the others."""
    uniform: tuple[Number, Number] | None = None
    """Ends of an interval, all of which is equally likely."""
    log_uniform: tuple[Positive, Positive] | None = None
    """Ends of an interval of which the logarithm is equally likely."""
    normal: tuple[Number, Number] | None = None
    """Mean and standard deviation of a normal distribution."""
    relative: Flag = False
    """Add the drawn value to the field's value in the template."""

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of the draw."""
        given = [way for way in WAYS if getattr(self, way) is not None]
        if len(given) != 1:
            what = f"{' and '.join(given)} are given" if given else "nothing to draw from is given"
            yield Fault((), None, f"{what}: give one of {', '.join(WAYS)}")
            return
        for way in ("uniform", "log_uniform"):
            ends = getattr(self, way)
            if ends is not None and not ends[0] < ends[1]:
                yield Fault((way,), list(ends), "is empty: the first value must be below the second")
        if self.normal is not None and not self.normal[1] > 0.0:
            yield Fault(("normal",), list(self.normal), "the second value, the standard deviation, must be above 0")
        if self.values is not None and not self.values:
            yield Fault(("values",), [], "must not be empty")
        if self.relative and (self.files is not None or not all(map(is_number, self.values or ()))):
            yield Fault(("relative",), True, "only numbers can be added to the template's value")

    def candidates(self, folder: Path) -> tuple[Any, ...]:
        """Return the candidates: values, or the existing files sorted by name; () for a distribution.

        Parameters
        ----------
        folder : Path
            Base folder of the pattern.
        """
        if self.files is None:
            return self.values or ()
        pattern = f"{self.files}/*" if (folder / self.files).is_dir() else self.files
        # Path.glob takes no absolute pattern.
        names = glob.glob(pattern, root_dir=folder, recursive=True)  # noqa: PTH207
        return tuple(name for name in sorted(names) if (folder / name).is_file())

    def quantile(self, share: float) -> float:
        """Return the quantile of the distribution."""
        if self.log_uniform is not None:
            low, high = map(math.log, self.log_uniform)
            return min(max(math.exp(low + share * (high - low)), self.log_uniform[0]), self.log_uniform[1])
        return float(Axis(path=self.path, uniform=self.uniform, normal=self.normal).quantiles(np.array(share))[()])


class DatasetFile(Model):
    """Content of a dataset file."""

    schema_version: Literal[1] = 1
    """Version of this format."""
    name: Text = ""
    """Name of the dataset."""
    scene: Text
    """Scene file of the template, relative to this file."""
    count: Count | None = None
    """Number of items; `--count` replaces it."""
    seed: Whole = 0
    """Of the draws; `--seed` replaces it."""
    parts: tuple[Text, ...] = PARTS
    """Parts made besides raw images: "white" images, once a camera; "views", the decoded light field; "depth", its
    truth, of views and pixels; "camera", the camera model, once a camera."""
    views: Count | None = None
    """Views along each axis; as many pixels as a micro-image is wide, if omitted."""
    changes: dict[str, Any] = Field(default_factory=dict)
    """Values that hold for every item, by their path, such as "transport.samples" = 64."""
    random: tuple[Draw, ...] = ()
    """Quantities drawn anew for every item."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between the fields."""
        for i, part in enumerate(self.parts):
            if part not in PARTS:
                yield Fault(("parts", i), part, f"unknown part{nearest(part, PARTS)}; there are {', '.join(PARTS)}")
        if not self.random:
            yield Fault(("random",), None, "missing: the values to draw for every item")
        paths = [draw.path for draw in self.random]
        for i, path in enumerate(paths):
            if path in paths[:i]:
                yield Fault(("random", i, "path"), path, "is drawn already")


def read_dataset(path: Path) -> DatasetFile:
    """Read a dataset file.

    Raises
    ------
    LfmeshError
        The file cannot be read or is not valid TOML or not a valid dataset; one line per fault.
    """
    return read_tables(path, DatasetFile, "dataset")
