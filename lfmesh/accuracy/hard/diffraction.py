"""Lenslets with diffraction that spreads light over most of a micro-image."""

import numpy as np
from scipy.special import j1

from lfmesh.accuracy.hard.outcome import Outcome, case, images_of, of_images
from lfmesh.accuracy.hard.truth import Array
from lfmesh.scene import Camera, Lens, MicrolensArray, Scene, Sensor, Surface, Target
from lfmesh.scene.objects.shapes import Disk
from lfmesh.scene.objects.targets import Material

PITCH_MM, PIXELS, F_NUMBER, NM = 0.01, 10, 8.0, 550.0
"""Lenslet pitch, pixels behind a lenslet, f-number of both lenses, and wavelength."""

ALLOWED = 0.006
"""Sum of differences from the closed form, over the light: 0.25 % for cosines and glass lenslets, the rest noise."""

ORDERS = 60
"""Orders of the Fourier series over a pitch; it has none beyond p² / (λ f)."""


def _white_picture() -> Array:
    """Return the fraction of a lenslet's light on each of its pixels, (n, n), by scalar waves at small angles.

    The pupil's image, a disk as wide as a lenslet, is convolved with sinc² in both axes and summed over all lenslets: a
    Fourier series over the pitch, times the transfer function of a square (J. W. Goodman, Introduction to Fourier
    Optics, 6.3).
    """
    order = np.arange(-ORDERS, ORDERS + 1)
    passed = np.clip(1.0 - np.abs(order) * NM * 1e-6 * F_NUMBER / PITCH_MM, 0.0, None) * np.sinc(order / PIXELS)
    x = np.pi * np.hypot(order[:, None], order)
    disk = np.divide(2.0 * j1(x), x, out=np.ones_like(x), where=x > 0.0)
    at = (np.arange(PIXELS) - 0.5 * (PIXELS - 1)) / PIXELS
    waves = np.exp(2j * np.pi * np.outer(at, order)) * passed
    return np.asarray((waves @ disk @ waves.T).real / PIXELS**2)


@case
def lenslets_10_um_and_pixels_1_um() -> Outcome:
    """Diffract light behind lenslets of 10 µm at f/8, over nine of their ten pixels of 1 µm."""
    away, across, disk_mm = 40.0, 31, 1e4
    lens = Surface(paraxial=True, focal_length_mm=away, semi_diameter_mm=0.5 * away / F_NUMBER, stop=True)
    mla = MicrolensArray(
        count=(across, across), pitch_mm=PITCH_MM, focal_length_mm=(F_NUMBER * PITCH_MM,), index=1.5, thickness_mm=0.01,
        distance_mm=away,
    )  # fmt: skip
    # The part imaged on the array, all of it visible to the neighbours of the middle lenslet.
    radius = 0.75 * across * PITCH_MM / away * disk_mm + 1.5 * away / F_NUMBER
    scene = Scene(
        camera=Camera(
            lens=Lens(surfaces=(lens,)), mla=mla, sensor=Sensor(pixels=(PIXELS, PIXELS), pixel_mm=PITCH_MM / PIXELS)
        ),
        targets=(
            Target(
                shape=Disk(radius_mm=radius), position_mm=(0.0, 0.0, -disk_mm),
                material=Material(reflectance=0.0, radiance_w_m2_sr=1.0),
            ),
        ),
    )  # fmt: skip
    images = images_of(scene, range(4), diffraction="lenslets", samples=16384, split="transmit", wavelengths_nm=(NM,))
    mean = np.sum([image.mean[..., 0] for image in images], axis=0)
    off = float(np.abs(mean / mean.sum() - _white_picture()).sum())
    return of_images(
        images, f"the closed form, within {ALLOWED:.1%}", f"{off:.2%} of the light elsewhere", off < ALLOWED
    )
