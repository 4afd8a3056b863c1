"""Axes of a study: a field of the scene and its values."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import Count, Flag, Number, Positive, Text, Whole

Array = NDArray[np.float64]

WAYS = ("values", "range", "log_range", "uniform", "normal")
"""Keys that define an axis's values."""


class Axis(Model):
    """A field of the scene that varies."""

    path: Text
    """The field, such as "camera.mla.pose.tilt_deg[0]"."""
    values: tuple[Any, ...] | None = None
    """The values themselves: numbers, names or lists, as the field takes them."""
    range: tuple[Number, Number] | None = None
    """First and last of `count` evenly spaced values."""
    log_range: tuple[Positive, Positive] | None = None
    """First and last of `count` values with a constant ratio."""
    uniform: tuple[Number, Number] | None = None
    """Ends of an interval from which `count` values are drawn."""
    normal: tuple[Number, Number] | None = None
    """Mean and standard deviation of a normal distribution from which `count` values are drawn."""
    count: Count | None = None
    """Number of values; the designs "latin_hypercube" and "sobol" have one `count` for all axes."""
    seed: Whole = 0
    """Of what is drawn."""
    relative: Flag = False
    """Add the values to the field's value in the reference camera."""
    label: Text | None = None
    """Name of the axis in figures."""

    @property
    def title(self) -> str:
        """Name of the axis in reports, with its unit."""
        return titled(self.path, self.label)

    @property
    def way(self) -> str | None:
        """Key from `WAYS` that defines the values."""
        return next((way for way in WAYS if getattr(self, way) is not None), None)

    @property
    def is_spread(self) -> bool:
        """True if the axis has a distribution that yields any number of values."""
        return self.way not in (None, "values")

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of the values."""
        given = [way for way in WAYS if getattr(self, way) is not None]
        if len(given) != 1:
            what = f"{' and '.join(given)} are given" if given else "it has no values"
            yield Fault((), None, f"{what}: give one of {', '.join(WAYS)}")
            return
        for way in ("range", "log_range", "uniform"):
            ends = getattr(self, way)
            if ends is not None and not ends[0] < ends[1]:
                yield Fault((way,), list(ends), "is empty: the first value must be below the second")
        if self.normal is not None and not self.normal[1] > 0.0:
            yield Fault(("normal",), list(self.normal), "the second value, the standard deviation, must be above 0")
        if self.values is not None:
            if not self.values:
                yield Fault(("values",), [], "must not be empty")
            if self.count is not None:
                yield Fault(("count",), self.count, "omit it: values are given one by one")
            if self.relative and not all(is_number(value) for value in self.values):
                yield Fault(("values",), list(self.values), "must be numbers with relative = true")

    def listed(self) -> list[Any]:
        """Return the values of an axis alone, in order."""
        if self.values is not None:
            return list(self.values)
        count = self.count or 1
        if self.uniform is not None or self.normal is not None:
            return [float(value) for value in self.quantiles(np.random.default_rng(self.seed).random(count))]
        return [
            float(value) for value in self.quantiles(np.linspace(0.0, 1.0, count) if count > 1 else np.array([0.5]))
        ]

    def quantiles(self, share: Array) -> Array:
        """Return quantiles of the axis's distribution; a range counts as uniform.

        Parameters
        ----------
        share : (n,) float64
            Probabilities, 0 to 1.
        """
        if self.normal is not None:
            from scipy.stats import norm

            mean, deviation = self.normal
            # A sequence that begins at 0 would give minus infinity.
            tiny = 2.0**-53
            return mean + deviation * np.asarray(norm.ppf(np.clip(share, tiny, 1.0 - tiny)))
        if self.log_range is not None:
            first, last = (math.log(end) for end in self.log_range)
            values = np.exp(first + share * (last - first))
            # The ends are exactly as written, without rounding error.
            return np.where(share == 0.0, self.log_range[0], np.where(share == 1.0, self.log_range[1], values))
        ends = self.uniform or self.range
        assert ends is not None
        return np.where(share == 1.0, ends[1], ends[0] + share * (ends[1] - ends[0]))


UNITS = {"mm": "mm", "deg": "deg", "nm": "nm", "px": "pixels", "w": "W", "um": "µm", "k": "K"}
"""Units by the suffix of a field's name."""


def titled(path: str, label: str | None) -> str:
    """Return the title of a field in reports: its label, or its path with the unit of its suffix.

    Parameters
    ----------
    path : str
    label : str or None
    """
    if label is not None:
        return label
    field = path.rsplit(".", 1)[-1].split("[")[0]
    unit = UNITS.get(field.rsplit("_", 1)[-1]) if "_" in field else None
    return f"{path} / {unit}" if unit else path


def name_and_unit(title: str) -> tuple[str, str]:
    """Split a title into name and unit ("" without one)."""
    name, slash, unit = title.rpartition(" / ")
    return (name, unit) if slash else (title, "")


def is_number(value: Any) -> bool:
    """Tell whether a value is a finite number that can be added to."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
