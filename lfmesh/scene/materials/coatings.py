"""Coatings of interfaces: a fixed reflectance, a measured table, or a stack of layers."""

import re
from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from lfmesh.scene.model import Fault, Model, nearest
from lfmesh.scene.quantities import FilePath, FractionOfOne, GlassName, Positive

UNCOATED = "none"
"""Name of the coating that every scene has: bare."""

MOST_LAYERS = 1000

LayerIndex = Annotated[float, Field(strict=True, gt=0, le=20)]
Extinction = Annotated[float, Field(strict=True, ge=0, le=100)]

_NAME = re.compile(r"[A-Za-z0-9_-]+")


class Layer(Model):
    """A plane layer of a coating."""

    index: LayerIndex | None = None
    """Refractive index. Or give `glass`."""
    extinction: Extinction = 0.0
    """Imaginary part k of the index n + ik, of a layer that absorbs (no unit); beside `index` only."""
    glass: GlassName | None = None
    """A glass or film of the catalogue, like "SCHOTT/N-BK7" or "main/TiO2/Devore-o", with its extinction where the
    catalogue has it."""
    thickness_nm: Positive
    """Thickness, in nm."""

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong between the fields."""
        if self.index is None and self.glass is None:
            yield Fault(("index",), None, "missing: give the index of the layer, or glass")
        elif self.index is not None and self.glass is not None:
            yield Fault(("glass",), self.glass, f"index = {self.index:g} is given too; give one of them")
        elif self.glass is not None and self.extinction:
            yield Fault(("extinction",), self.extinction, "omit it: the catalogue gives that of a glass")


class Coating(Model):
    """Coating of an interface: one of `reflectance`, `table` and `layers`."""

    reflectance: FractionOfOne | None = None
    """Share of the light that is reflected, 0..1, at every angle and wavelength; the rest passes."""
    table: FilePath | None = None
    """A CSV file, relative to the scene file, with the columns wavelength_nm, angle_deg (in the thinner medium, from 0
    to 90) and reflectance, every angle at every wavelength; what is not reflected passes. Between wavelengths it is
    linear, between angles a monotone cubic in the cosine, as layers behave: give angles close enough."""
    layers: tuple[Layer, ...] | None = None
    """The layers of a stack, from the air side to the glass; between two glasses from the object to the sensor."""

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong between the fields."""
        given = [key for key in ("reflectance", "table", "layers") if getattr(self, key) is not None]
        if not given:
            yield Fault((), None, "a coating needs one of reflectance, table and layers")
        if self.layers is not None and not 0 < len(self.layers) <= MOST_LAYERS:
            yield Fault(
                ("layers",), None, f"a stack has 1 to {MOST_LAYERS} layers, and this one has {len(self.layers)}"
            )
        for key in given[1:]:
            yield Fault((key,), None, f"{given[0]} is given too; give one of them")


def name_fault(name: str) -> str | None:
    """Return why a coating cannot have a name; None if it can."""
    if name == UNCOATED:
        return f'"{UNCOATED}" stands for a bare surface; take another name'
    if not _NAME.fullmatch(name):
        return "a name of a coating has letters, digits, _ and - only"
    return None


def unknown_fault(name: str, known: Iterator[str] | list[str] | tuple[str, ...]) -> str | None:
    """Return what is wrong with the name of a coating that a surface gives; None if there is such a coating."""
    names = [*known, UNCOATED]
    if name in names:
        return None
    return f"no coating has this name{nearest(name, names)}; there are {', '.join(names)}"
