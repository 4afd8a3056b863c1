"""Materials of glTF files: base colour, metallic, roughness, as gloss over a base and as metal.

glTF 2.0, appendix B: a material is a mixture, by its metallic value, of a dielectric of index 1.5 over a diffuse base
with the base colour, and of a metal whose reflectance at normal incidence is the base colour. Both have GGX facets with
α = roughness². The two parts are those of `optics.gloss`, which lose no light that facets reflect several times; the
mixture of two reciprocal parts that gain nothing is reciprocal and gains nothing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.gloss import gloss_parameters, interface_reflectance
from lfmesh.optics.rgb_spectra import primary_reflectances

Array = NDArray[np.float64]

DIELECTRIC_INDEX = 1.5
"""Of every material that is no metal (glTF 2.0, appendix B.3.3)."""

SMALLEST_ALPHA = 0.01
"""Of a gloss, as `scene.targets` has it."""

HALVINGS = 50


@dataclass(frozen=True)
class GltfMaterial:
    """A material of a glTF file.

    Attributes
    ----------
    base : (float, float, float)
        Base colour factor, linear sRGB. A base colour texture multiplies it, point by point.
    metallic, roughness : float
        As the file gives them, 0..1; of a texture the mean.
    """

    base: tuple[float, float, float]
    metallic: float
    roughness: float

    @property
    def alpha(self) -> float:
        """Walter's α_g, as far down as a gloss may go."""
        return max(self.roughness**2, SMALLEST_ALPHA)


def gltf_parameters(material: GltfMaterial, wavelengths_nm: tuple[float, ...], surroundings: Array) -> Array:
    """Return the parameters of both parts as kernels take them, first the dielectric's, (2 ROWS, wavelengths).

    Parameters
    ----------
    material : GltfMaterial
    wavelengths_nm : (wavelengths,) tuple of float
    surroundings : (wavelengths,) float64
        Refractive index of what the material stands in; that part which is a metal has its colour in any.
    """
    colour = np.clip([primary_reflectances(w) @ material.base for w in wavelengths_nm], 0.0, 1.0)
    dielectric = np.asarray(DIELECTRIC_INDEX / surroundings, np.complex128)
    return np.concatenate(
        [
            gloss_parameters(colour, dielectric, material.alpha),
            gloss_parameters(colour, metal_of_reflectance(colour), material.alpha),
        ]
    )


def metal_of_reflectance(reflectance: Array) -> NDArray[np.complex128]:
    """Return n + ik of metals with a given reflectance at normal incidence.

    Of the metals that have it (Gulbrandsen, "Artist Friendly Metallic Fresnel", JCGT 3(4), 2014, numbers them by an
    edge tint from 0 to 1) the one whose mean over the hemisphere is that of Schlick's approximation, which glTF takes:
    r + (1 - r) / 21; where none is, the nearest.

    Parameters
    ----------
    reflectance : (n,) float64
        0..1; 1 is a perfect mirror.
    """
    r = np.clip(reflectance, 1e-6, 1.0 - 1e-9)
    x, w = np.polynomial.legendre.leggauss(64)
    cosine = 0.5 * (x + 1.0)
    low, high = np.zeros_like(r), np.ones_like(r)
    for _ in range(HALVINGS):
        tint = 0.5 * (low + high)
        n = _with_tint(r, tint)
        mean = interface_reflectance(n.real[:, None], n.imag[:, None], cosine) @ (w * cosine)
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
