"""Keys and optics that the phases of all kinds share."""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from lfmesh.errors import SceneError
from lfmesh.optics.blaze import blaze_share
from lfmesh.optics.glass import Medium, refractive_index
from lfmesh.optics.phase_shapes import PhaseProfile, vertex_derivatives
from lfmesh.scene.camera.orders import Efficiency, Order, OrderNumber, Shares, efficiency_faults, order_faults
from lfmesh.scene.light.spectra import Resolves, Spectrum
from lfmesh.scene.model import Fault, Location, Model
from lfmesh.scene.quantities import Positive

MM_PER_NM = 1e-6

Levels = Annotated[int, Field(strict=True, ge=2, le=65536)]


class Phase(Model):
    """Keys that all phases share: the diffraction orders, and their shares of the light."""

    order: OrderNumber | None = None
    """Diffraction order that light is traced in. Or give `orders`. Omitted: 1, or `blaze_order`."""
    orders: tuple[Order, ...] = ()
    """Several transmitted orders, such as [{ order = 0, share = 0.1 }, { order = 1, share = 0.8 }]. Each is traced; the
    rest of the light is absorbed. Omitted: `order` alone."""
    efficiency: Efficiency = "ideal"
    """Share of the transmitted light in the orders. "ideal": all light in `order`, or the given shares of `orders`.
    "blaze": the scalar efficiency of a blazed profile, which needs `design_nm` and different media on both sides. A
    number from 0 to 1, or { wavelengths_nm = [...], values = [...] }, multiplies the "ideal" shares."""
    design_nm: Positive | None = None
    """Design wavelength, in nm, of a "blaze" and of a "metalens"."""
    levels: Levels | None = None
    """Number of steps of a "blaze", 2 for a binary profile. Omitted: a continuous profile."""
    blaze_order: OrderNumber = 1
    """Order that has all light of a continuous "blaze" at its design wavelength."""
    reflected_orders: tuple[Order, ...] = ()
    """Orders of reflected light, with their shares of it. Omitted: all reflected light is in the order 0."""

    needs_design: ClassVar[bool] = False
    """True if the shape of the phase depends on `design_nm`."""

    @property
    def listed(self) -> tuple[int, ...]:
        """Transmitted orders that are traced."""
        if self.orders:
            return tuple(each.order for each in self.orders)
        return (self.order if self.order is not None else self.blaze_order,)

    @property
    def main_order(self) -> int:
        """Listed order with the largest share, by a "blaze" at its design wavelength; first-order optics follow it."""
        shares = [blaze_share(self.blaze_order, order, self.levels or 0) for order in self.listed]
        if self.efficiency != "blaze":
            shares = [1.0 if each.share is None else each.share for each in self.orders] or [1.0]
        return self.listed[shares.index(max(shares))]

    @property
    def has_one_order(self) -> bool:
        """True if there is one transmitted order, and reflected light keeps to the order 0."""
        return len(self.listed) == 1 and all(order == 0 for order, _ in self.reflected())

    def orders_of(self, wavelength_nm: float, n_before: Medium, n_behind: Medium) -> Shares:
        """Return the transmitted orders with their shares of the transmitted light.

        Parameters
        ----------
        wavelength_nm : float
        n_before, n_behind : Medium
            Media on both sides of the surface: an index, a glass, or None for air. The order does not matter.

        Returns
        -------
        tuple of (int, float)

        Raises
        ------
        SceneError
            The table of the efficiency does not cover the wavelength.
        GlassError
            An index is unknown at this or at the design wavelength.
        """
        if self.efficiency == "blaze":
            alpha = self.blaze_order * self.blaze_phase(wavelength_nm, n_before, n_behind)
            return tuple((order, blaze_share(alpha, order, self.levels or 0)) for order in self.listed)
        factor = self._factor(wavelength_nm)
        shares = [each.share if each.share is not None else 1.0 for each in self.orders] or [1.0]
        return tuple((order, share * factor) for order, share in zip(self.listed, shares, strict=True))

    def blaze_phase(self, wavelength_nm: float, n_before: Medium, n_behind: Medium) -> float:
        """Return the phase step of a blaze at a wavelength, over that at its design wavelength.

        With n and n' on both sides it is (λ₀/λ)(n − n')/(n₀ − n₀').

        Parameters
        ----------
        wavelength_nm, n_before, n_behind
            As in `orders_of`.

        Returns
        -------
        float
        """
        design = self.design_nm or math.nan
        steps = [
            refractive_index(n_before, each) - refractive_index(n_behind, each) for each in (wavelength_nm, design)
        ]
        return design / wavelength_nm * steps[0] / steps[1] if steps[1] else math.nan

    def _factor(self, wavelength_nm: float) -> float:
        """Return the efficiency as a factor of the shares."""
        given = self.efficiency
        if isinstance(given, Spectrum):
            nodes, values = given.wavelengths_nm or (), given.values or ()
            if not nodes[0] <= wavelength_nm <= nodes[-1]:
                raise SceneError(
                    f"efficiency: its table extends from {nodes[0]:g} to {nodes[-1]:g} nm, without {wavelength_nm:g} nm"
                )
            return float(np.interp(wavelength_nm, nodes, values))
        return 1.0 if isinstance(given, str) else given

    def reflected(self) -> Shares:
        """Return the orders of reflected light with their shares of it.

        Returns
        -------
        tuple of (int, float)
        """
        return tuple((each.order, each.share or 0.0) for each in self.reflected_orders) or ((0, 1.0),)

    def profile(self) -> PhaseProfile:
        """Return the phase as its numbers.

        Returns
        -------
        PhaseProfile
        """
        return _profile(self)

    def _shape(self) -> PhaseProfile:
        raise NotImplementedError

    def terms_rad(self, radius_mm: float) -> Iterator[tuple[Location, float, float]]:
        """Yield the terms of a polynomial phase with any coefficients.

        Parameters
        ----------
        radius_mm : float
            Largest distance from the vertex.

        Yields
        ------
        location : tuple of str and int
            Keys of the coefficient from the phase.
        coefficient : float
        largest : float
            Largest magnitude of the term up to this distance, in rad; inf beyond float64.
        """
        yield from ()

    def read_in(self, scene: Resolves) -> "Phase":
        """Return the phase with the contents of its file, if it has one.

        Parameters
        ----------
        scene : Scene
            Scene that paths start from.

        Returns
        -------
        Phase
        """
        return self

    @property
    def reach_mm(self) -> float:
        """Distance from the vertex along x and y up to which the phase is known, in mm."""
        return math.inf

    @property
    def of_revolution(self) -> bool:
        """True if the phase depends on the distance from the vertex alone."""
        return True

    @property
    def symmetric(self) -> bool:
        """True if the phase is symmetric about x and about y."""
        return self.of_revolution

    @property
    def gradient_rad_mm(self) -> tuple[float, float]:
        """Derivatives by x and by y at the vertex, in rad/mm."""
        return vertex_derivatives(self.profile())[:2]

    @property
    def curvature_rad_mm2(self) -> tuple[float, float, float]:
        """Derivatives at the vertex by x twice, by x and y, and by y twice, in rad/mm²."""
        return vertex_derivatives(self.profile())[2:]

    def path_per_rad_mm(self, wavelength_nm: float) -> float:
        """Return m λ/2π of the main order: the change of the optical path per rad of phase.

        Parameters
        ----------
        wavelength_nm : float

        Returns
        -------
        float
            mm.
        """
        return self.main_order * wavelength_nm * MM_PER_NM / (2.0 * math.pi)

    def power_per_mm(self, wavelength_nm: float, section_x: bool = False) -> float:
        """Return the power of the main order, which adds to that of refraction.

        Parameters
        ----------
        wavelength_nm : float
        section_x : bool
            Return it for the section x–z in place of y–z.

        Returns
        -------
        float
            1/mm.
        """
        in_x, _, in_y = self.curvature_rad_mm2
        # Adding 0 makes a vanishing power positive.
        return -self.path_per_rad_mm(wavelength_nm) * (in_x if section_x else in_y) + 0.0

    def in_words(self) -> str:
        """Return the kind, the orders and their efficiency.

        Returns
        -------
        str
        """
        kind = str(getattr(self, "kind", "phase"))
        orders = ", ".join(str(order) for order in self.listed)
        words = [kind, f"order{'s' if len(self.listed) > 1 else ''} {orders}"]
        if self.efficiency == "blaze":
            steps = f" in {self.levels} levels" if self.levels is not None else ""
            words.append(f"blazed for {self.design_nm:g} nm{steps}")
        elif isinstance(self.efficiency, Spectrum):
            words.append("efficiency by wavelength")
        elif not isinstance(self.efficiency, str):
            words.append(f"efficiency {self.efficiency:g}")
        return ", ".join(words)

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        if self.orders and self.order is not None:
            yield Fault(("order",), self.order, "orders is given too; give one of them")
        blazed = self.efficiency == "blaze"
        yield from order_faults("orders", self.orders, gives_shares=not blazed)
        yield from order_faults("reflected_orders", self.reflected_orders, gives_shares=True)
        if isinstance(self.efficiency, Spectrum):
            yield from efficiency_faults(self.efficiency)
        if self.design_nm is None and (blazed or self.needs_design):
            yield Fault(("design_nm",), None, "missing: the design wavelength")
        elif self.design_nm is not None and not blazed and not self.needs_design:
            yield Fault(("design_nm",), self.design_nm, 'omit it: it belongs to efficiency = "blaze"')
        if not blazed and self.levels is not None:
            yield Fault(("levels",), self.levels, 'omit it: it belongs to efficiency = "blaze"')
        if not blazed and self.blaze_order != 1:
            yield Fault(("blaze_order",), self.blaze_order, 'omit it: it belongs to efficiency = "blaze"')
        elif self.blaze_order == 0:
            yield Fault(("blaze_order",), 0, "must not be 0: that profile would be flat")


def term_rad(coefficient: float, ratio: float, power: int) -> float:
    """Return the magnitude of a term of a polynomial phase, inf on overflow.

    Parameters
    ----------
    coefficient : float, rad
    ratio : float
        Distance over the length that it is divided by.
    power : int
    """
    with np.errstate(over="ignore"):
        return float(abs(coefficient) * np.float64(ratio) ** power) if coefficient else 0.0


@lru_cache(maxsize=64)
def _profile(phase: Phase) -> PhaseProfile:
    return phase._shape()
