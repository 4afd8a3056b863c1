"""The families of exceptions and warnings.

Everything a user can cause ends in an `LfmeshError` with one clear message. Everything by which a picture is or may be
wrong is a `PictureWarning`: a warning of Python, a line on the command line and an entry in `report.json`.
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
    """A mistake the user can mend: the message names the field or file, the value, and what is valid."""

    longest_line: ClassVar[int] = 1500
    """Most characters of a line of its message: a value of a broken file may be of any length."""

    def __str__(self) -> str:
        """Return the message, without the middle of lines that are too long to be read."""
        return "\n".join(_shortened(line, self.longest_line) for line in super().__str__().split("\n"))


def _shortened(line: str, most: int) -> str:
    return line if len(line) <= most else f"{line[: most // 2]} … {line[-(most // 2) :]}"


class SceneError(LfmeshError):
    """The scene file or model is wrong; the message lists every fault, one a line."""


class MeshError(LfmeshError):
    """A mesh file is missing, empty, broken, or not what its use needs."""


class GlassError(LfmeshError):
    """A glass or refractive index that the catalogue does not hold at the wished wavelength."""


class FileError(LfmeshError):
    """A run folder, image or texture cannot be read or written."""


class LensFileWarning(UserWarning):
    """A lens file, mesh file or glTF scene was read with approximations, or holds what the reader does not know."""


class PlainNumbaWarning(UserWarning):
    """Kernels are compiled by numba alone, which takes longer; pictures are the same."""


class PictureWarning(UserWarning):
    """A picture is or may be wrong. Two are equal if they are of one class and say the same.

    The message is one line in plain English: what is wrong, the value, what to do. The order of the classes below is
    that in which they are said, most important first.
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
        """Return the warning that `as_dict` was made from; of a class that this version does not know as one of `cls`.

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
    """Samples that are not aimed found more or less light than the picture has: the picture is wrong."""


class LostEnergyWarning(PictureWarning):
    """The tracer lost more of the energy than rounding explains."""


class OpenLedgerWarning(PictureWarning):
    """The energy ledger does not close, or values of the picture are no numbers: a fault of the tracer."""


class CutPathsWarning(PictureWarning):
    """Paths that still carried light were cut by `transport.max_events`."""


class HiddenSceneWarning(PictureWarning):
    """A closed body stands round the camera and hides the scene."""


class MissedLightWarning(PictureWarning):
    """Light is left out, or found so seldom that the picture may be darker than its error says."""


class LightOutsideAimWarning(PictureWarning):
    """Rays are not aimed, or not proven to be, at all light that comes through the lens: the rest comes as noise."""


class HeavyPathsWarning(PictureWarning):
    """Few paths bring much of the light of some pixels: their errors are too small.

    So are their upper bounds, where no neighbours have met such paths.
    """


class InterruptedRenderWarning(PictureWarning):
    """A render was cut short: the picture has fewer samples than were asked for."""


class TooFewSamplesWarning(PictureWarning):
    """Many pixels have so few samples with light that their errors are not known well."""


class ClosedGapWarning(PictureWarning):
    """Faces of glass are so close that they are taken to touch."""


class CutBodiesWarning(PictureWarning):
    """Curved bodies of glass cut each other: rays near the cut may take one for the other."""


class FoldedPatchesWarning(PictureWarning):
    """The normals of curved glass do not fit its facets: rays that graze it may pass it."""


class ClearAirWarning(PictureWarning):
    """A scene has media that take light away, and its projection matrix leaves them out."""


class FineVoxelsWarning(PictureWarning):
    """Voxels are finer than the camera resolves: a volume reconstructed with them owes its details to the method."""


class UnknownErrorWarning(PictureWarning):
    """Nobody can tell how far a reconstructed volume is from the truth: its image does not say enough."""


class OrderCheckWarning(PictureWarning):
    """Surfaces found by their order are not those found by their meshes, which were used instead."""


class DiffractionWarning(PictureWarning):
    """Diffraction changes a real camera's picture, and is not traced, or not finely enough."""


def in_order(found: Iterable[PictureWarning]) -> tuple[PictureWarning, ...]:
    """Return warnings once each, the most important first."""
    kinds = PictureWarning.__subclasses__()
    return tuple(sorted(dict.fromkeys(found), key=lambda each: kinds.index(type(each)) if type(each) in kinds else -1))


_listening: ContextVar[tuple[list[Warning], ...]] = ContextVar("listening", default=())


@contextmanager
def heard() -> Iterator[list[Warning]]:
    """Note what `warn_caller` warns of inside, which is shown as ever.

    Yields
    ------
    list of Warning
        Grows with every warning.
    """
    found: list[Warning] = []
    token = _listening.set((*_listening.get(), found))
    try:
        yield found
    finally:
        _listening.reset(token)


def warn_caller(found: Iterable[Warning]) -> None:
    """Warn of each, at the line outside this package from which it was called."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_INSIDE):
        level, frame = level + 1, frame.f_back
    for each in found:
        for notes in _listening.get():
            notes.append(each)
        warnings.warn(each, stacklevel=level)


@contextmanager
def collected() -> Iterator[list[PictureWarning]]:
    """Collect the warnings of all pictures made inside, in place of showing them; others are shown as ever.

    Yields
    ------
    list of PictureWarning
        Grows while pictures are made.
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
    """Return one warning for each class of those of many pictures: how many have it, and what the first of them says.

    Parameters
    ----------
    found : mapping
        Warnings of each, by its name.
    total : int
        Number of all, those without warnings included.
    things : str
        Plural of their kind: "points".
    """
    by_kind: dict[type[PictureWarning], dict[str, PictureWarning]] = {}
    for name, own in found.items():
        for warning in own:
            by_kind.setdefault(type(warning), {}).setdefault(name, warning)
    return in_order(
        kind(f"{len(own)} of {total} {things}, such as {next(iter(own))}: {next(iter(own.values()))}")
        for kind, own in by_kind.items()
    )
