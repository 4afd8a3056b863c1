"""Wavelengths ("lines") at which a scene is traced: the columns of all spectral tables.

Without bands each wavelength of the scene is a line and a channel of the image. A band is divided into strata, each
with a line at the centroid of the response within it. Every sample takes one of a band's lines, with a chance equal to
the line's share of the response; the samples of a pixel cover the band evenly, with the pixel's own offset. So pixels
are independent, and a pixel's error includes the noise of its wavelengths.

The lines do not depend on the seed. The integral over a band becomes a sum over its lines: for light of the mean over
each stratum, for everything else of the value at its line. The sum is right to second order in the width of the strata;
its error is smallest if the density of lines follows the cube root of the response.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.optics.curve import Curve
from lfmesh.scene import Scene

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

SPACING = 0.007
"""Distance between lines at the peak of a band's response, over the wavelength.

With it, integrals over the bands "rgb" and "xyz" and over Gaussians, under the illuminants of the CIE, are wrong by at
most 1e-3 of the value for a white surface. That holds for the spectra of the ColorChecker, transmittances of catalogue
glasses, and coatings, ghosts of coatings and mirrors of up to 15 layers."""

LEAST_LINES, MOST_LINES = 8, 64
"""Least and largest number of lines of a band."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """Lines of a channel, and their chances.

    Attributes
    ----------
    first : int
        Column of the first line.
    until : (lines,) float64
        Cumulative chance, up to 1.
    """

    first: int
    until: Array

    @classmethod
    def single(cls, column: int) -> "Nodes":
        """Return the only line of a channel."""
        return cls(column, np.ones(1))

    def columns(self, places: ArrayLike) -> Numbers:
        """Return the columns of the lines taken by samples at places in [0, 1).

        Places up to one half go up through the band, the others down, so that evenly spaced samples wrap around without
        a jump.

        Parameters
        ----------
        places : (...) float64
        """
        share = 1.0 - np.abs(2.0 * np.asarray(places) - 1.0)
        return np.asarray(self.first + np.searchsorted(self.until[:-1], share, side="right"), np.int64)


FIRST = Nodes.single(0)
"""The first of all lines."""


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines of a scene.

    Attributes
    ----------
    wavelengths_nm : tuple of float
        Of each column; the lines of a band are adjacent and increase.
    weight_nm : (columns,) float64, nm
        Integral of the band's response, which turns a density per nm into a power; 1 without bands.
    nodes : tuple of Nodes
        Of each channel.
    span_nm : (float, float) or None
        Ends of the range covered by the bands; None without bands.
    strata : tuple of (Curve, (lines + 1,) float64)
        Response of each band, and the ends of its strata, nm.
    """

    wavelengths_nm: tuple[float, ...]
    weight_nm: Array
    nodes: tuple[Nodes, ...]
    span_nm: tuple[float, float] | None
    strata: tuple[tuple[Curve, Array], ...] = ()

    @classmethod
    def of(cls, scene: Scene) -> "Lines":
        """Return the lines of a scene.

        Raises
        ------
        FileError
            A response file cannot be used.
        """
        if not scene.passbands:
            return cls.single(scene.transport.wavelengths_nm)
        strata = tuple((band.response, _strata(band.response)) for band in scene.passbands)
        areas = [response.integrals(edges) for response, edges in strata]
        first = np.cumsum([0, *map(len, areas)])
        nodes = tuple(Nodes(int(k), np.cumsum(area) / area.sum()) for k, area in zip(first, areas, strict=False))
        weights = [np.full(len(area), area.sum()) for area in areas]
        centroids = [_means(response, edges, Curve(edges, edges)) for response, edges in strata]
        wavelengths_nm = tuple(np.concatenate(centroids).tolist())
        return cls(wavelengths_nm, np.concatenate(weights), nodes, scene.reach_nm, strata)

    @classmethod
    def single(cls, wavelengths_nm: tuple[float, ...]) -> "Lines":
        """Return single wavelengths as lines, each a channel."""
        nodes = tuple(map(Nodes.single, range(len(wavelengths_nm))))
        return cls(wavelengths_nm, np.ones(len(wavelengths_nm)), nodes, None)

    @property
    def in_bands(self) -> bool:
        """True if channels are bands."""
        return self.span_nm is not None

    @property
    def channels(self) -> int:
        """Number of channels of the image."""
        return len(self.nodes)

    @property
    def middle(self) -> Nodes:
        """The middle line of the first channel, for computations at one wavelength."""
        return Nodes.single(int(self.nodes[0].columns(0.25)))

    def mean(self, spectrum: Curve) -> Array:
        """Return a spectrum's mean over the stratum of each line, weighted with the response, (columns,)."""
        if self.span_nm is None:
            return spectrum.at(self.wavelengths_nm)
        return np.concatenate([_means(response, edges, spectrum) for response, edges in self.strata])

    def power(self, total: float, shape: Curve | None = None) -> Array:
        """Return the share of a light's power for each line, (columns,).

        Without bands each line has the whole power. With bands the power is spread over their range, and each line has
        its detected part.

        Parameters
        ----------
        total : float
            Power, or irradiance or radiance.
        shape : Curve, optional
            Spectrum of the power; constant by default.
        """
        if self.span_nm is None:
            return np.full(len(self.weight_nm), total)
        first, last = self.span_nm
        if shape is None:
            return total / (last - first) * self.weight_nm
        return total / shape.integral(first, last) * self.mean(shape) * self.weight_nm

    def nearest(self, wavelength_nm: float) -> int:
        """Return the column with the nearest wavelength."""
        return int(np.argmin(np.abs(np.array(self.wavelengths_nm) - wavelength_nm)))


def _means(response: Curve, edges: Array, spectrum: Curve) -> Array:
    """Return the means of a spectrum over strata, weighted with a response; in a gap, the value in the middle."""
    area, middle = response.integrals(edges), spectrum.at(0.5 * (edges[1:] + edges[:-1]))
    return np.divide(response.integrals(edges, spectrum), area, out=middle, where=area > 0.0)


def _strata(response: Curve) -> Array:
    """Return the ends of a band's strata, nm, with equal integrals of the cube root of its response.

    No stratum crosses a gap in the response.
    """
    knots, values = response.wavelengths_nm, response.values
    root = Curve(knots, np.cbrt(values))
    wide = root.area_nm / (root.values.max() * SPACING * response.centroid_nm)
    count = int(np.clip(np.ceil(wide), LEAST_LINES, MOST_LINES))
    lit = np.convolve(values > 0.0, (1, 1, 1), mode="same") > 0
    return np.union1d(root.quantile_nm(np.linspace(0.0, 1.0, count + 1)), knots[lit & (values == 0.0)])
