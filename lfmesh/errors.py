"""Families of exceptions and warnings.

Every mistake of a user ends in an `LfmeshError` with one clear message. Every possible fault of a picture is a
`PictureWarning`: a Python warning, a line on the command line and an entry in `report.json`.
"""

import os
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, ClassVar, Self

_INSIDE = f"{Path(__file__).parent}{os.sep}"


class LfmeshError(Exception):
    """A mistake the user can mend; the message names the field or file, the value, and valid values."""

    longest_line: ClassVar[int] = 1500
    """Largest number of characters in a line of its message; a value from a broken file may have any length."""

    def __str__(self) -> str:
        """Return the message, without the middle of very long lines."""
        return "\n".join(_shortened(line, self.longest_line) for line in super().__str__().split("\n"))


def _shortened(line: str, most: int) -> str:
    return line if len(line) <= most else f"{line[: most // 2]} … {line[-(most // 2) :]}"


class SceneError(LfmeshError):
    """The scene file or model is wrong; the message lists every fault, one per line."""


class MeshError(LfmeshError):
    """A mesh file is missing, empty, broken, or unsuitable for its use."""


class GlassError(LfmeshError):
    """The catalogue lacks a glass, or its refractive index at a wavelength."""


class FileError(LfmeshError):
    """A run folder, image or texture cannot be read or written."""


class LensFileWarning(UserWarning):
    """A lens file, mesh file or glTF scene was read with approximations, or has unknown content."""


class PlainNumbaWarning(UserWarning):
    """Kernels are compiled by numba alone, which takes longer; pictures are the same."""


class PictureWarning(UserWarning):
    """A picture is or may be wrong. Two warnings are equal if class and message are.

    The message is one line in plain English: fault, value, remedy. The classes below are in the order of reports, most
    important first.
    """

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and str(self) == str(other)

    def __hash__(self) -> int:
        return hash((type(self), str(self)))

    def as_dict(self) -> dict[str, str]:
        """Return the warning for JSON.

        Returns
        -------
        dict of str
        """
        return {"kind": type(self).__name__, "text": str(self)}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """Return a warning from `as_dict`; a class unknown to this version becomes `cls`.

        Parameters
        ----------
        values : dict
            With `kind` and `text`.

        Returns
        -------
        PictureWarning
        """
        kind, text = str(values["kind"]), str(values["text"])
        return next((each for each in cls.__subclasses__() if each.__name__ == kind), cls)(text)


class BlackPictureWarning(PictureWarning):
    """No path found light: all pixels are 0."""


class BlindCheckWarning(PictureWarning):
    """Unaimed samples found more or less light than the picture has: the picture is wrong."""


class LostEnergyWarning(PictureWarning):
    """The tracer lost more energy than rounding errors explain."""


class OpenLedgerWarning(PictureWarning):
    """The energy ledger does not close, or pixels are not numbers: a fault of the tracer."""


class CutPathsWarning(PictureWarning):
    """Paths that still carried light were cut by `transport.max_events`."""


class HiddenSceneWarning(PictureWarning):
    """A closed body stands round the camera and hides the scene."""


class MissedLightWarning(PictureWarning):
    """Light is left out, or found so seldom that the picture may be darker than its error says."""


class LightOutsideAimWarning(PictureWarning):
    """Rays are not, or not provably, aimed at all light that comes through the lens: the rest adds noise."""


class HeavyPathsWarning(PictureWarning):
    """A few paths carry much of the light of some pixels, so that their errors are underestimated.

    So are their upper bounds, unless neighbours have met such paths.
    """


class InterruptedRenderWarning(PictureWarning):
    """A render was interrupted: the picture has fewer samples than requested."""


class TooFewSamplesWarning(PictureWarning):
    """Many pixels have too few samples with light for a good error estimate."""


class ClosedGapWarning(PictureWarning):
    """Glass faces are so close that they are taken to touch."""


class CutBodiesWarning(PictureWarning):
    """Curved glass bodies intersect: rays near the intersection may take one for the other."""


class FoldedPatchesWarning(PictureWarning):
    """The normals of curved glass do not match its facets: grazing rays may miss it."""


class CoarseFieldWarning(PictureWarning):
    """The grid of a medium that bends light is too coarse: its deflection is wrong by more than rounding."""


class ClearAirWarning(PictureWarning):
    """A projection matrix ignores absorbing or scattering media of the scene."""


class FineVoxelsWarning(PictureWarning):
    """Voxels are finer than the camera's resolution: a volume's details come from the method."""


class UnknownErrorWarning(PictureWarning):
    """The error of a reconstructed volume is unknown: its image does not determine it."""


class OrderCheckWarning(PictureWarning):
    """Surfaces found by sequence differ from those found by meshes; the meshes were used."""


class DiffractionWarning(PictureWarning):
    """Diffraction changes a real camera's picture, and is not traced, or not finely enough."""


def in_order(found: Iterable[PictureWarning]) -> tuple[PictureWarning, ...]:
    """Return warnings without repetitions, most important first."""
    kinds = PictureWarning.__subclasses__()
    return tuple(sorted(dict.fromkeys(found), key=lambda each: kinds.index(type(each)) if type(each) in kinds else -1))


_listening: ContextVar[tuple[list[Warning], ...]] = ContextVar("listening", default=())


@contextmanager
def heard() -> Iterator[list[Warning]]:
    """Record the warnings that `warn_caller` issues inside; they are still shown.

    Yields
    ------
    list of Warning
        List that grows with every warning.
    """
    found: list[Warning] = []
    token = _listening.set((*_listening.get(), found))
    try:
        yield found
    finally:
        _listening.reset(token)


def warn_caller(found: Iterable[Warning]) -> None:
    """Issue each warning at the line outside this package that called it."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_INSIDE):
        level, frame = level + 1, frame.f_back
    for each in found:
        for notes in _listening.get():
            notes.append(each)
        warnings.warn(each, stacklevel=level)


@contextmanager
def collected() -> Iterator[list[PictureWarning]]:
    """Collect the warnings of pictures made inside instead of showing them; others are shown.

    Yields
    ------
    list of PictureWarning
        List that grows while pictures are made.
    """
    found: list[PictureWarning] = []
    usual = warnings.showwarning

    def keep(message: Warning | str, category: type[Warning], *rest: Any, **options: Any) -> None:
        if isinstance(message, PictureWarning):
            found.append(message)
        else:
            usual(message, category, *rest, **options)

    with warnings.catch_warnings():
        warnings.simplefilter("always", PictureWarning)
        warnings.showwarning = keep
        yield found


def summed_up(found: Mapping[str, Iterable[PictureWarning]], total: int, things: str) -> tuple[PictureWarning, ...]:
    """Return one warning per class for many pictures: their number, and the first one's message.

    Parameters
    ----------
    found : mapping
        Warnings of each picture, by its name.
    total : int
        Number of all pictures, warned of or not.
    things : str
        Plural noun for the pictures: "points".
    """
    by_kind: dict[type[PictureWarning], dict[str, PictureWarning]] = {}
    for name, own in found.items():
        for warning in own:
            by_kind.setdefault(type(warning), {}).setdefault(name, warning)
    return in_order(
        kind(f"{len(own)} of {total} {things}, such as {next(iter(own))}: {next(iter(own.values()))}")
        for kind, own in by_kind.items()
    )
