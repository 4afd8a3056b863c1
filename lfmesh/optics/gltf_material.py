"""Materials of glTF files: base colour, metallic, roughness, as gloss over a base and as metal.

glTF 2.0, appendix B: a material is a mixture, by its metallic value, of a dielectric of index 1.5 over a diffuse base
with the base colour, and of a metal whose reflectance at normal incidence is the base colour. Both have GGX facets with
α = roughness². The two parts are those of `optics.gloss`, which lose no light that facets reflect several times; the
mixture of two reciprocal parts that gain nothing is reciprocal and gains nothing.

A picture may vary metallic and roughness over the surface. Each point then mixes four materials of a `GltfRange`: of
the least and the largest metallic, which is exact, and of the two nearest roughnesses. Such a mixture is reciprocal and
gains nothing either. Its density of facets is off by at most RATIO²/2, 1.04 %, from that of the roughness itself.
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
"""Of every material that is no metal (glTF 2.0, appendix B.3.3)."""

SMALLEST_ALPHA = 0.01
"""Of a gloss, as `scene.targets` has it."""

ROUGHNESSES = 32
"""Intervals of ln α, of equal width from `SMALLEST_ALPHA` to 1, between whose ends a picture's roughness is mixed."""

RATIO = -math.log(SMALLEST_ALPHA) / ROUGHNESSES
"""Width of an interval. GGX's density of facets, α² / (π cos⁴θ (α² + tan²θ)²), mixed linearly in ln α between two
ends is off by at most RATIO²/8 times the largest of its second derivative over its value, 4 at θ = 0 and at 90°."""

HALVINGS = 50


@dataclass(frozen=True)
class GltfMaterial:
    """A material of a glTF file.

    Attributes
    ----------
    base : (float, float, float)
        Base colour factor, linear sRGB. A base colour texture multiplies it, point by point.
    metallic, roughness : float
        As the file gives them, 0..1.
    """

    base: tuple[float, float, float]
    metallic: float
    roughness: float

    @property
    def alpha(self) -> float:
        """Walter's α_g, as far down as a gloss may go."""
        return max(self.roughness**2, SMALLEST_ALPHA)


@dataclass(frozen=True)
class GltfRange:
    """Materials of one base colour that differ in metallic and roughness.

    Attributes
    ----------
    base : (float, float, float)
    metallic : (float, float)
        The least and the largest.
    first, last : int
        The first and the last roughness: α = exp(RATIO (k − ROUGHNESSES)).
    """

    base: tuple[float, float, float]
    metallic: tuple[float, float]
    first: int
    last: int

    @classmethod
    def of(cls, base: tuple[float, float, float], metallic: Array, roughness: Array) -> "GltfRange":
        """Return the range that holds some values.

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
        """Materials by roughness, two each: of the least metallic, of the largest."""
        alphas = [math.exp(RATIO * (k - ROUGHNESSES)) for k in range(self.first, self.last + 1)]
        return tuple(GltfMaterial(self.base, metallic, math.sqrt(a)) for a in alphas for metallic in self.metallic)


def gltf_parameters(
    materials: Sequence[GltfMaterial], wavelengths_nm: tuple[float, ...], surroundings: Array
) -> list[Array]:
    """Return the parameters of both parts of materials as kernels take them, each (2 ROWS, wavelengths).

    Those of the dielectric come first.

    Parameters
    ----------
    materials : sequence of GltfMaterial
    wavelengths_nm : (wavelengths,) tuple of float
    surroundings : (materials, wavelengths) float64
        Refractive index of what each material stands in; that part which is a metal has its colour in any.
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
    """Return n + ik of metals with a given reflectance at normal incidence.

    Of the metals that have it (Gulbrandsen, "Artist Friendly Metallic Fresnel", JCGT 3(4), 2014, numbers them by an
    edge tint from 0 to 1) the one whose mean over the hemisphere is that of Schlick's approximation, which glTF takes:
    r + (1 - r) / 21; where none is, the nearest.

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
    """Return n + ik of a reflectance and an edge tint."""
    root = np.sqrt(r)
    n = tint * (1.0 - r) / (1.0 + r) + (1.0 - tint) * (1.0 + root) / (1.0 - root)
    k = np.sqrt(np.maximum((r * (n + 1.0) ** 2 - (n - 1.0) ** 2) / (1.0 - r), 0.0))
    # An extinction coefficient of zero would make it a dielectric, with a base below.
    return np.asarray(n + 1j * np.maximum(k, 1e-9))
