"""First-order optics against published lenses and textbook formulas."""

import math

import pytest

from lfmesh.scene import Camera, Lens, Paraxial, Scene, Sensor, Surface, Transport, first_order


def conventional(lens: Lens, wavelength_nm: float, image_mm: float) -> Scene:
    """A camera without an array, its sensor at a distance behind the lens."""
    return Scene(
        camera=Camera(lens=lens, sensor=Sensor(pixels=(100, 100), pixel_mm=0.01, distance_mm=image_mm)),
        transport=Transport(wavelengths_nm=(wavelength_nm,)),
    )


# The f/5 Cooke triplet that comes with ray-optics, Optiland (optiland/samples/objectives.py) and OpticStudio.
COOKE_TRIPLET = Lens(
    surfaces=(
        Surface(radius_mm=22.01359, thickness_mm=3.25896, glass="HIKARI/SK16", semi_diameter_mm=9.5),
        Surface(radius_mm=-435.76044, thickness_mm=6.00755, semi_diameter_mm=9.5),
        Surface(radius_mm=-22.21328, thickness_mm=0.99997, glass="SCHOTT/F2", semi_diameter_mm=5.0),
        Surface(radius_mm=20.29192, thickness_mm=4.75041, stop=True),
        Surface(radius_mm=79.68360, thickness_mm=2.95208, glass="HIKARI/SK16", semi_diameter_mm=7.5),
        Surface(radius_mm=-18.39533, semi_diameter_mm=7.5),
    ),
    f_number=5.0,
)


def test_cooke_triplet() -> None:
    facts = first_order(conventional(COOKE_TRIPLET, 550.0, 42.414858))
    # Published at 0.55 µm, to the last digit given.
    assert facts.efl_mm == pytest.approx(49.999783, abs=5e-7)
    assert facts.bfl_mm == pytest.approx(42.414858, abs=5e-7)
    # f/5: its published entrance pupil is 10 mm wide.
    assert facts.entrance_pupil_diameter_mm == pytest.approx(10.0, rel=1e-5)
    assert facts.working_f_number == pytest.approx(5.0, rel=1e-7)


def test_ball_lens() -> None:
    """EFL = n D / (4 (n − 1)), BFL = EFL − D/2, and both principal planes pass through the centre."""
    ball = Lens(
        surfaces=(
            Surface(radius_mm=5.0, thickness_mm=10.0, index=1.5, semi_diameter_mm=3.0, stop=True),
            Surface(radius_mm=-5.0, semi_diameter_mm=3.0),
        )
    )
    facts = first_order(conventional(ball, 587.6, 2.5))
    assert facts.efl_mm == pytest.approx(7.5, rel=1e-14)
    assert facts.bfl_mm == pytest.approx(2.5, rel=1e-14)
    assert facts.ffl_mm == pytest.approx(-2.5, rel=1e-14)
    assert facts.front_principal_plane_z_mm == pytest.approx(5.0, rel=1e-14)
    assert facts.rear_principal_plane_z_mm == pytest.approx(5.0, rel=1e-14)
    assert facts.object_distance_mm == math.inf


def test_achromat_of_a_catalogue() -> None:
    """Thorlabs AC254-100-A: EFL 100.1 mm, BFL 97.1 mm at 587.6 nm, in the digits the catalogue gives."""
    achromat = Lens(
        surfaces=(
            Surface(radius_mm=62.75, thickness_mm=4.0, glass="SCHOTT/N-BK7", semi_diameter_mm=11.43, stop=True),
            Surface(radius_mm=-45.71, thickness_mm=2.5, glass="SCHOTT/SF5", semi_diameter_mm=11.43),
            Surface(radius_mm=-128.23, semi_diameter_mm=11.43),
        )
    )
    paraxial = Paraxial.of(achromat, 587.6)
    assert paraxial.efl_mm == pytest.approx(100.1, abs=0.05)
    assert paraxial.bfl_mm == pytest.approx(97.1, abs=0.1)


@pytest.mark.parametrize("object_mm", [150.0, 400.0, 1e5])
def test_thin_lens_formula(object_mm: float) -> None:
    """1/s + 1/s' = 1/f and m = −s'/s for a weak lens as thin as paper, f = R / (2 (n − 1))."""
    thin = Lens(
        surfaces=(
            Surface(radius_mm=100.0, thickness_mm=1e-6, index=1.5, semi_diameter_mm=0.01, stop=True),
            Surface(radius_mm=-100.0, semi_diameter_mm=0.01),
        )
    )
    image_mm = 1 / (1 / 100.0 - 1 / object_mm)
    paraxial = Paraxial.of(thin, 587.6)
    assert paraxial.efl_mm == pytest.approx(100.0, rel=1e-7)
    assert paraxial.image_mm(object_mm) == pytest.approx(image_mm, rel=1e-7)
    assert paraxial.object_mm(image_mm) == pytest.approx(object_mm, rel=1e-4)
    assert paraxial.magnification(object_mm) == pytest.approx(-image_mm / object_mm, rel=1e-6)


def test_thick_lens_formula() -> None:
    """1/f = (n − 1) (1/R1 − 1/R2 + (n − 1) t / (n R1 R2)), BFL = f (1 − (n − 1) t / (n R1))."""
    n, r1, r2, t = 1.7, 30.0, -80.0, 9.0
    thick = Lens(
        surfaces=(
            Surface(radius_mm=r1, thickness_mm=t, index=n, semi_diameter_mm=5.0, stop=True),
            Surface(radius_mm=r2, semi_diameter_mm=5.0),
        )
    )
    f = 1 / ((n - 1) * (1 / r1 - 1 / r2 + (n - 1) * t / (n * r1 * r2)))
    paraxial = Paraxial.of(thick, 587.6)
    assert paraxial.efl_mm == pytest.approx(f, rel=1e-14)
    assert paraxial.bfl_mm == pytest.approx(f * (1 - (n - 1) * t / (n * r1)), rel=1e-14)
    # Newton: (s − front focal distance) (s' − back focal distance) = f².
    assert (250.0 + paraxial.ffl_mm) * (paraxial.image_mm(250.0) - paraxial.bfl_mm) == pytest.approx(f * f)
