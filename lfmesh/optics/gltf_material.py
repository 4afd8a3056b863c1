"""Materials of glTF files (base colour, metallic, roughness), as mixtures of gloss over a base and of metal.

glTF 2.0, appendix B: the metallic value mixes a dielectric of index 1.5 over a diffuse base of the base colour with a
metal that has the base colour as reflectance at normal incidence. Both have GGX facets with α = roughness². The two
parts come from `optics.gloss`, which keeps the light of multiple facet reflections. They and hence their mixture are
reciprocal and gain no energy.

If a picture varies metallic and roughness, each point mixes four materials of a `GltfRange`: the smallest and largest
metallic, which is exact, and the two nearest roughnesses. Its density of facets differs from that of the true roughness
by at most RATIO²/2, 1.04 %.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.gloss import gloss_parameters, interface_reflectance
from lfmesh.optics.quadrature import gauss_legendre
from lfmesh.optics.rgb_spectra import primary_reflectances

Array = NDArray[np.float64]

DIELECTRIC_INDEX = 1.5
"""Index of all non-metals (glTF 2.0, appendix B.3.3)."""

SMALLEST_ALPHA = 0.01
"""Smallest α of a gloss, as in `scene.targets`."""

ROUGHNESSES = 32
"""Number of equal intervals of ln α from `SMALLEST_ALPHA` to 1; a picture's roughness is mixed between their ends."""

RATIO = -math.log(SMALLEST_ALPHA) / ROUGHNESSES
"""Width of an interval. GGX's density of facets, α² / (π cos⁴θ (α² + tan²θ)²), interpolated linearly in ln α, is off by
at most RATIO²/8 times its second derivative over its value, which is at most 4 (at θ = 0 and 90°)."""

HALVINGS = 50


@dataclass(frozen=True)
class GltfMaterial:
    """A material of a glTF file.

    Attributes
    ----------
    base : (float, float, float)
        Base colour factor, linear sRGB; a texture multiplies it.
    metallic, roughness : float
        Values in the file, 0..1.
    """

    base: tuple[float, float, float]
    metallic: float
    roughness: float

    @property
    def alpha(self) -> float:
        """Walter's α_g, at least `SMALLEST_ALPHA`."""
        return max(self.roughness**2, SMALLEST_ALPHA)


@dataclass(frozen=True)
class GltfRange:
    """Materials of one base colour that differ in metallic and roughness.

    Attributes
    ----------
    base : (float, float, float)
    metallic : (float, float)
        Smallest and largest.
    first, last : int
        First and last roughness: α = exp(RATIO (k − ROUGHNESSES)).
    """

    base: tuple[float, float, float]
    metallic: tuple[float, float]
    first: int
    last: int

    @classmethod
    def of(cls, base: tuple[float, float, float], metallic: Array, roughness: Array) -> "GltfRange":
        """Return the range that contains given values.

        Parameters
        ----------
        base : (float, float, float)
        metallic, roughness : float64, any shape
        """
        ends = [GltfMaterial(base, 0.0, float(each)).alpha for each in (roughness.min(), roughness.max())]
        low, high = (ROUGHNESSES + math.log(alpha) / RATIO for alpha in ends)
        first, last = max(0, math.floor(low)), min(ROUGHNESSES, math.ceil(high))
        return cls(base, (float(metallic.min()), float(metallic.max())), first, last)

    @property
    def materials(self) -> tuple[GltfMaterial, ...]:
        """Materials in order of roughness, two each: with the smallest and the largest metallic."""
        alphas = [math.exp(RATIO * (k - ROUGHNESSES)) for k in range(self.first, self.last + 1)]
        return tuple(GltfMaterial(self.base, metallic, math.sqrt(a)) for a in alphas for metallic in self.metallic)


def gltf_parameters(
    materials: Sequence[GltfMaterial], wavelengths_nm: tuple[float, ...], surroundings: Array
) -> list[Array]:
    """Return the parameters of both parts of materials for the kernels, each (2 ROWS, wavelengths), dielectric first.

    Parameters
    ----------
    materials : sequence of GltfMaterial
    wavelengths_nm : (wavelengths,) tuple of float
    surroundings : (materials, wavelengths) float64
        Refractive index around each material; a metal keeps its colour in any.
    """
    if not materials:
        return []
    primaries = [primary_reflectances(w) for w in wavelengths_nm]
    colours = np.clip([[each @ material.base for each in primaries] for material in materials], 0.0, 1.0)
    dielectrics = np.asarray(DIELECTRIC_INDEX / surroundings, np.complex128)
    return [
        np.concatenate(
            [gloss_parameters(colour, dielectric, material.alpha), gloss_parameters(colour, metal, material.alpha)]
        )
        for material, colour, dielectric, metal in zip(
            materials, colours, dielectrics, metal_of_reflectance(colours), strict=True
        )
    ]


def metal_of_reflectance(reflectance: Array) -> NDArray[np.complex128]:
    """Return n + ik of metals with given reflectances at normal incidence.

    An edge tint from 0 to 1 parametrises such metals (Gulbrandsen, "Artist Friendly Metallic Fresnel", JCGT 3(4),
    2014). It is chosen for the hemispherical mean of glTF's Schlick approximation, r + (1 - r) / 21, or the nearest.

    Parameters
    ----------
    reflectance : float64, any shape
        0..1; 1 is a perfect mirror.
    """
    r = np.clip(reflectance, 1e-6, 1.0 - 1e-9)
    x, w = gauss_legendre(64)
    cosine = 0.5 * (x + 1.0)
    low, high = np.zeros_like(r), np.ones_like(r)
    for _ in range(HALVINGS):
        tint = 0.5 * (low + high)
        n = _with_tint(r, tint)
        mean = interface_reflectance(n.real[..., None], n.imag[..., None], cosine) @ (w * cosine)
        above = mean > r + (1.0 - r) / 21.0
        low, high = np.where(above, low, tint), np.where(above, tint, high)
    return _with_tint(r, 0.5 * (low + high))


def _with_tint(r: Array, tint: Array) -> NDArray[np.complex128]:
    """Return n + ik for a reflectance and an edge tint."""
    root = np.sqrt(r)
    n = tint * (1.0 - r) / (1.0 + r) + (1.0 - tint) * (1.0 + root) / (1.0 - root)
    k = np.sqrt(np.maximum((r * (n + 1.0) ** 2 - (n - 1.0) ** 2) / (1.0 - r), 0.0))
    # With zero extinction it would be a dielectric over a base.
    return np.asarray(n + 1j * np.maximum(k, 1e-9))
