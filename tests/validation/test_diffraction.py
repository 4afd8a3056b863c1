"""Airy disks against the diffraction integral, printed tables and cameras worked out by hand."""

import numpy as np
import pytest

from lfmesh.scene import Camera, Lens, MicrolensArray, Scene, Sensor, Surface, Transport, first_order
from lfmesh.scene.first_order.compute import airy_disk_mm


def test_the_disk_ends_where_the_light_of_a_round_pupil_first_cancels() -> None:
    """Fraunhofer's integral over the pupil: its waves cancel on the first dark ring, and nowhere inside."""
    wavelength_nm, f_number = 632.8, 11.0
    ring = 0.5 * airy_disk_mm(wavelength_nm, f_number)
    # Pupil coordinate p from −1 to 1, whose chords are 2 √(1 − p²) long; the phase there is k p r sin θ'.
    p, weight = np.polynomial.legendre.leggauss(200)
    phase = 2.0 * np.pi / (wavelength_nm * 1e-6) * p / (2.0 * f_number)
    chord = 2.0 * np.sqrt(1.0 - p * p) * weight

    def amplitude(r: float) -> float:
        return float((chord * np.cos(phase * r)).sum() / np.pi)

    assert amplitude(0.0) == pytest.approx(1.0, abs=1e-6)
    assert all(amplitude(share * ring) > 1e-3 for share in np.linspace(0.0, 0.99, 100))
    assert abs(amplitude(ring)) < 1e-6
    assert amplitude(1.01 * ring) < -1e-3


@pytest.mark.parametrize(
    ("wavelength_nm", "f_number", "printed_um"), [(550, 4, 5.37), (532, 8, 10.38), (850, 2.8, 5.81)]
)
def test_printed_diameters(wavelength_nm: float, f_number: float, printed_um: float) -> None:
    """A table of Airy disk diameters in air (codingace.net/physics/airy_disk_diameter.php), to its last digit."""
    assert 1e3 * airy_disk_mm(wavelength_nm, f_number) == pytest.approx(printed_um, abs=0.005)


def plano_convex(focal_mm: float, stop_mm: float) -> Lens:
    """A plano-convex lens, n 1.5: its front principal plane touches the vertex, where the stop is."""
    return Lens(
        surfaces=(
            Surface(radius_mm=0.5 * focal_mm, thickness_mm=3.0, index=1.5, semi_diameter_mm=stop_mm, stop=True),
            Surface(semi_diameter_mm=stop_mm),
        )
    )


def photographed(distance_mm: float) -> Scene:
    """A camera with a 50 mm lens at f/8, pixels of 5 µm, red, green and blue."""
    return Scene(
        camera=Camera(
            focus_mm=distance_mm, lens=plano_convex(50.0, 3.125), sensor=Sensor(pixels=(100, 100), pixel_mm=0.005)
        ),
        transport=Transport(wavelengths_nm=(450.0, 550.0, 650.0)),
    )


def test_close_up_the_disk_grows_with_the_image_distance() -> None:
    """N (1 + |m|): f/8 from afar, f/16 at life size, where object and image are two focal lengths off."""
    far, near = first_order(photographed(1e9)), first_order(photographed(100.0))
    assert near.magnification == pytest.approx(-1.0, rel=1e-6)
    # 2.43934 · 0.65 µm · 8 and · 16, over 5 µm.
    assert far.airy_disk_samples == pytest.approx(2.53691, rel=1e-5)
    assert near.airy_disk_samples == pytest.approx(5.07383, rel=1e-5)
    assert near.airy_wavelength_nm == 650.0
    assert near.microlens_airy_disk_px is None
    assert any(line.startswith("Airy disk, lens        25.37 µm, 5.07 pixels, at 650 nm") for line in near.lines())


def test_a_stop_behind_the_lens_counts_with_its_distance_from_the_image() -> None:
    """A stop 20 mm behind the lens is its own exit pupil: infinity is imaged 50 − 3/1.5 = 48 mm behind the lens, 28 mm
    behind the stop, which is 5 mm wide: f/5.6."""
    front, back = plano_convex(50.0, 5.0).surfaces
    surfaces = (
        front.model_copy(update={"stop": False}),
        back.model_copy(update={"thickness_mm": 20.0}),
        Surface(stop=True, semi_diameter_mm=2.5),
    )
    camera = Camera(lens=Lens(surfaces=surfaces), sensor=Sensor(pixels=(10, 10), pixel_mm=0.005, distance_mm=28.0))
    facts = first_order(Scene(camera=camera, transport=Transport(wavelengths_nm=(500.0,))))
    assert 1e3 * facts.airy_disk_mm == pytest.approx(2.43934 * 0.5 * 5.6, rel=1e-5)


def plenoptic(stop_mm: float, pitch_mm: float, lenslet_mm: float, pixel_mm: float, focal_mm: float = 140.0) -> Scene:
    """A plenoptic camera that is focused far away."""
    return Scene(
        camera=Camera(
            focus_mm=1e9,
            lens=plano_convex(focal_mm, stop_mm),
            mla=MicrolensArray(
                count=(8, 8), pitch_mm=pitch_mm, focal_length_mm=lenslet_mm, index=1.5, thickness_mm=0.5 * lenslet_mm
            ),
            sensor=Sensor(pixels=(64, 64), pixel_mm=pixel_mm),
        ),
        transport=Transport(wavelengths_nm=(550.0,)),
    )


def test_the_first_hand_held_plenoptic_camera() -> None:
    """R. Ng et al. 2005: 140 mm lens at f/4, lenslets of 125 µm and f = 500 µm, pixels of 9 µm. By hand, at 550 nm:
    2.43934 · 0.55 · 4 = 5.3666 µm, 0.0429 lenslets, 0.596 pixels."""
    facts = first_order(plenoptic(17.5, 0.125, 0.5, 0.009))
    assert facts.airy_disk_samples == pytest.approx(5.36656 / 125.0, rel=1e-5)
    assert facts.microlens_airy_disk_px == pytest.approx(5.36656 / 9.0, rel=1e-5)
    assert not any("Airy" in warning for warning in facts.warnings)


@pytest.mark.parametrize(
    ("f_number", "lenslet_um", "pixel_um", "warned"),
    [
        (4.0, 50.0, 6.0, []),
        (8.0, 50.0, 6.0, []),
        (12.0, 50.0, 6.0, ["lens's Airy disk is 1.07 lenslets"]),
        (4.0, 75.0, 6.0, ["microlenses' Airy disk is 1.12 pixels"]),
        (16.0, 75.0, 3.0, ["lens's Airy disk is 1.43 lenslets", "microlenses' Airy disk is 2.24 pixels"]),
    ],
)
def test_disks_wider_than_what_samples_them_are_warned_of(
    f_number: float, lenslet_um: float, pixel_um: float, warned: list[str]
) -> None:
    """Lenslets of 15 µm: 2.43934 · 0.55 · N over 15 µm, and for f/3.33 and f/5 over the pixels."""
    facts = first_order(plenoptic(70.0 / f_number, 0.015, lenslet_um * 1e-3, pixel_um * 1e-3))
    said = [warning for warning in facts.warnings if "Airy" in warning]
    assert len(said) == len(warned)
    for warning, words in zip(said, warned, strict=True):
        assert f"the {words} wide" in warning
