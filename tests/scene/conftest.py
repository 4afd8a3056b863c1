"""A small plenoptic camera to vary: a weak singlet behind its stop, a square array, a plane, a lamp."""

import pytest

from lfmesh.scene import (
    Camera,
    Lens,
    Material,
    MicrolensArray,
    Plane,
    PointLight,
    Scene,
    Sensor,
    Surface,
    Target,
)


@pytest.fixture
def scene() -> Scene:
    return Scene(
        name="singlet",
        camera=Camera(
            focus_mm=400.0,
            lens=Lens(
                surfaces=(
                    Surface(stop=True, thickness_mm=2.0, semi_diameter_mm=6.0),
                    Surface(radius_mm=60.0, thickness_mm=4.0, index=1.5, semi_diameter_mm=10.0),
                    Surface(radius_mm=-60.0, semi_diameter_mm=10.0),
                )
            ),
            mla=MicrolensArray(
                count=(32, 24),
                pitch_mm=0.12,
                focal_length_mm=0.7,
                index=1.5,
                thickness_mm=0.3,
                curved_side="lens",
            ),
            sensor=Sensor(pixels=(320, 240), pixel_mm=0.012),
        ),
        targets=(
            Target(
                shape=Plane(width_mm=10.0, height_mm=10.0),
                position_mm=(0.0, 0.0, -400.0),
                material=Material(reflectance=0.5),
            ),
        ),
        lights=(PointLight(position_mm=(50.0, 0.0, -100.0), power_w=2.0),),
    )
