"""A scene that is being drawn: its tables, the sizes that its parts follow from, and the table of all features."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Tables = dict[str, Any]


class NotDrawnError(Exception):
    """What was drawn cannot be built, for a stated reason: the scene is drawn again."""


class Dice:
    """Random numbers of five digits, so that scenes are short as text."""

    def __init__(self, *key: int) -> None:
        self.draw = np.random.default_rng(key)

    def between(self, low: float, high: float) -> float:
        """Draw a number evenly."""
        return rounded(self.draw.uniform(low, high))

    def log_between(self, low: float, high: float) -> float:
        """Draw a positive number whose logarithm is even."""
        return rounded(np.exp(self.draw.uniform(np.log(low), np.log(high))))

    def both_signs(self, low: float, high: float) -> float:
        """Draw a magnitude evenly, and a sign."""
        return self.between(low, high) * self.one_of(-1.0, 1.0)

    def vector(self, *reach: float) -> list[float]:
        """Draw each component evenly between plus and minus its reach."""
        return [self.between(-r, r) if r else 0.0 for r in reach]

    def one_of(self, *choices: Any) -> Any:
        """Draw one of several values."""
        return choices[int(self.draw.integers(len(choices)))]

    def chance(self, probability: float) -> bool:
        """Draw whether something happens."""
        return bool(self.draw.random() < probability)


def rounded(value: float) -> float:
    """Return a number with five digits."""
    return float(f"{value:.5g}")


@dataclass
class Draft:
    """A scene under way.

    Attributes
    ----------
    tables : dict
        Of the scene.
    focal_mm, f_number, focus_mm : float
        Of the lens as it is meant; `focus_mm` is the distance of the plane in focus.
    semi_mm : float
        Height of the marginal ray at the lens, mm.
    room_mm : float
        Free way before the sensor: from the array, or from the lens without one, mm.
    half_field_mm : float
        Half the wider side of what the sensor sees of the plane in focus, mm.
    groups : list of list of int
        Numbers of the surfaces of each element of the lens.
    """

    tables: Tables
    focal_mm: float
    f_number: float
    focus_mm: float
    semi_mm: float
    room_mm: float
    half_field_mm: float
    groups: list[list[int]] = field(default_factory=list)

    @property
    def camera(self) -> Tables:
        """Table of the camera."""
        return self.tables["camera"]

    @property
    def surfaces(self) -> list[Tables]:
        """Tables of the lens's surfaces."""
        return self.camera["lens"]["surfaces"]

    @property
    def curved(self) -> list[Tables]:
        """Tables of the surfaces that refract."""
        return [surface for surface in self.surfaces if "radius_mm" in surface]

    @property
    def transport(self) -> Tables:
        """Table of the transport settings."""
        return self.tables["transport"]

    def add(self, kind: str, *entries: Tables) -> None:
        """Add entries to a list of the scene: targets, lights, media, ..."""
        self.tables.setdefault(kind, []).extend(entries)


@dataclass(frozen=True)
class Feature:
    """A thing that a drawn camera or scene may have.

    Attributes
    ----------
    name : str
    in_cameras, in_scenes : float
        Chance that a drawn camera, or a drawn scene, tries to have it.
    own_kernels : bool
        Whether it compiles kernels that few others share; such features are left to the long tests.
    put : callable of (Draft, Dice)
        Puts it into a scene; returns False where it does not go with what is there.
    """

    name: str
    in_cameras: float
    in_scenes: float
    own_kernels: bool
    put: Callable[[Draft, Dice], bool | None]


FEATURES: dict[str, Feature] = {}
"""Every feature by its name, in the order in which they are put into a scene."""

Put = Callable[[Draft, Dice], bool | None]


def feature(cameras: float = 0.0, scenes: float = 0.0, *, own_kernels: bool = False) -> Callable[[Put], Put]:
    """Enter a function into the table of features, under its own name, with its chances in cameras and in scenes."""

    def enter(put: Put) -> Put:
        name = put.__name__
        FEATURES[name] = Feature(name, cameras, scenes, own_kernels, put)
        return put

    return enter
