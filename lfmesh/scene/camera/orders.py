"""Diffraction orders of a phase, and their shares of the light."""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from lfmesh.scene.light.spectra import Spectrum
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import FractionOfOne

MOST_ORDER = 1000

OrderNumber = Annotated[int, Field(strict=True, ge=-MOST_ORDER, le=MOST_ORDER)]
Shares = tuple[tuple[int, float], ...]
"""Diffraction orders, each with its share of the light."""

ROUNDED = 1e-12
"""Excess of a sum of shares over 1 that rounding explains."""


class Order(Model):
    """A diffraction order with its share of the light."""

    order: OrderNumber
    """Number of the order; 0 is light that the phase leaves alone."""
    share: FractionOfOne | None = None
    """Share of the light, 0..1. The shares of a list sum to 1 at most, and the rest is absorbed. Omitted: with
    `efficiency = "blaze"`, which gives it."""


def _efficiency_kind(value: object) -> str:
    if isinstance(value, str):
        return "<name>"
    return "<number>" if isinstance(value, int | float) else "<table>"


Efficiency = Annotated[
    Annotated[Literal["ideal", "blaze"], Tag("<name>")]
    | Annotated[FractionOfOne, Tag("<number>")]
    | Annotated[Spectrum, Tag("<table>")],
    Discriminator(_efficiency_kind),
]
"""Share of the light in the given orders: a name, a number from 0 to 1, or a table over wavelength."""


def order_faults(key: str, orders: Sequence[Order], *, gives_shares: bool) -> Iterator[Fault]:
    """Yield orders that occur twice, and shares that are missing, superfluous or above 1 in sum.

    Parameters
    ----------
    key : str
        Key of the list.
    orders : sequence of Order
    gives_shares : bool
        True if the orders give their shares themselves.
    """
    seen: set[int] = set()
    for i, each in enumerate(orders):
        if each.order in seen:
            yield Fault((key, i, "order"), each.order, "is listed twice; keep one")
        seen.add(each.order)
        if gives_shares and each.share is None:
            yield Fault((key, i, "share"), None, "missing: its share of the light, 0..1")
        elif not gives_shares and each.share is not None:
            yield Fault((key, i, "share"), each.share, 'omit it: efficiency = "blaze" gives the shares')
    total = math.fsum(each.share or 0.0 for each in orders)
    if total > 1.0 + ROUNDED:
        yield Fault((key,), None, f"the shares sum to {total:.6g}; they must sum to 1 or less")


def efficiency_faults(efficiency: Spectrum) -> Iterator[Fault]:
    """Yield faults of an efficiency by wavelength."""
    if efficiency.wavelengths_nm is None or efficiency.values is None:
        yield Fault(("efficiency",), None, "give wavelengths_nm with values, or a number from 0 to 1")
    elif outside := [value for value in efficiency.values if not 0.0 <= value <= 1.0]:
        yield Fault(("efficiency",), None, f"value {outside[0]:g}: an efficiency must lie between 0 and 1")
