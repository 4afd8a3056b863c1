"""Lines of a Zemax surface whose meaning depends on all of them: phases and gradient-index glass."""

from dataclasses import dataclass, field
from typing import NamedTuple

from lfmesh.imports.prescription import FileSurface, Prescription
from lfmesh.imports.report import Report


class Value(NamedTuple):
    """Number of a parameter or of extra data, with its line."""

    at: int
    text: str
    number: float


class UnreadableLineError(ValueError):
    """A line that the type of surface cannot have.

    Attributes
    ----------
    at, text : int, str
        Number (from 1) and text of the line.
    """

    def __init__(self, at: int, text: str, why: str) -> None:
        super().__init__(why)
        self.at, self.text = at, text


@dataclass
class SurfaceLines:
    """Lines of a surface, read once the file has ended.

    Attributes
    ----------
    kind : str
        Zemax's type.
    surface : FileSurface
    at, text : int, str
        Line of its type.
    parameters, extra : dict
        Values by place.
    """

    kind: str
    surface: FileSurface
    at: int
    text: str
    parameters: dict[int, Value] = field(default_factory=dict)
    extra: dict[int, Value] = field(default_factory=dict)

    def take(self, made: Prescription, report: Report) -> None:
        """Complete the surface, and give the lines their verdicts.

        Parameters
        ----------
        made : Prescription
            Of the whole file.
        report : Report
        """
        raise NotImplementedError

    def error(self, why: str, value: Value | None = None) -> UnreadableLineError:
        """Return the error about a value, or about the surface."""
        at, text = (self.at, self.text) if value is None else (value.at, value.text)
        return UnreadableLineError(at, text, why)

    def parameter(self, place: int) -> float:
        """Return a parameter; 0 if the file has none."""
        return self.parameters[place].number if place in self.parameters else 0.0

    def extra_number(self, place: int) -> float:
        """Return a number of the extra data; 0 if the file has none."""
        return self.extra[place].number if place in self.extra else 0.0

    def needed(self, place: int, noun: str) -> Value:
        """Return the value of a parameter that the file must give."""
        if place not in self.parameters:
            raise self.error(f"parameter {place}, {noun}, is missing")
        return self.parameters[place]

    def only(self, places: range) -> None:
        """Raise for a parameter other than 0 outside these places."""
        for place, value in self.parameters.items():
            if place not in places and value.number:
                raise self.error(f"parameter {place} of {self.kind} is unknown", value)
