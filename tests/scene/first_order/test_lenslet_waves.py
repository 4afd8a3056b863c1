"""Errors of white pictures behind the faces of lenslets: the limit of slow ones, and that of a camera."""

import math
from typing import Any

import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene.first_order import kick_error
from lfmesh.scene.first_order.lenslet_waves import Lenslet, error_on_true_faces, error_with_kick, lenslets_of
from lfmesh.scene.first_order.lenslets import lenslet_to_sensor_mm

WAVELENGTH_MM, SLOW, PIXELS, WIDTH = 587.6e-6, 60.0, 10, 0.9
"""Wavelength, f-number of slow lenslets, and the pixels and micro-images of the tables."""


def slow_error(fresnel: float, distance: float, layout: str, side: str, pixels: int = PIXELS) -> float:
    """Return the error behind lenslets so slow that they are thin: waves and rays of Fresnel's approximation."""
    pitch = 4.0 * fresnel * WAVELENGTH_MM * SLOW
    to_sensor, index, thickness = SLOW * pitch, 1.5, pitch
    reduced = thickness / index if side == "lens" else 0.0
    layers = (to_sensor - reduced, 1.0)
    plate = ((thickness, index), layers) if side == "lens" else (layers,)
    radius = (index - 1.0) * to_sensor / distance
    lenslet = Lenslet(pitch, layout, radius, 0.0, (), side, index, plate, WAVELENGTH_MM)
    return error_with_kick(lenslet, math.sin(math.atan(0.5 * WIDTH / SLOW)), pixels)


@pytest.mark.parametrize("side", ["lens", "sensor"])
@pytest.mark.parametrize(("fresnel", "distance"), [(0.7, 1.2), (2.0, 1.0), (2.0, 0.7), (3.0, 1.1)])
def test_behind_slow_square_lenslets_the_error_is_that_of_thin_ones(fresnel: float, distance: float, side: str) -> None:
    """The closed form shares no step with it: no face, no traced ray, no order of diffraction."""
    thin = kick_error.white_errors(fresnel, distance, WIDTH, PIXELS)[1]
    assert slow_error(fresnel, distance, "square", side) == pytest.approx(thin, rel=0.05, abs=5e-4)


@pytest.mark.parametrize(("number", "distance"), [(0, 0), (1, 1), (2, 2), (2, 4)])
def test_behind_slow_hexagons_the_error_is_that_of_the_tables(number: int, distance: int) -> None:
    found = slow_error(kick_error.FRESNEL_NUMBERS[number], kick_error.DISTANCES[distance], "hexagonal", "lens")
    assert found == pytest.approx(kick_error.HEXAGONS_WITH[distance][number], rel=0.05, abs=5e-4)


@pytest.mark.parametrize("side", ["lens", "sensor"])
@pytest.mark.parametrize("cover", [None, {"thickness_mm": 0.01, "gap_mm": 0.005, "index": 1.6}])
def test_the_way_behind_a_face_is_that_of_first_order_optics(side: str, cover: dict[str, Any] | None) -> None:
    changes = {"camera.mla.curved_side": side, "camera.mla.glass": "SCHOTT/N-BK7", "camera.mla.index": None}
    changes |= {"camera.sensor.cover": cover, "camera.mla.thickness_mm": 0.03}
    camera = lf.solved(lf.load(asset_path("scenes/diffraction.toml")).changed(changes)).camera
    assert camera.mla is not None
    (lenslet,) = lenslets_of(camera, 587.6)
    assert lenslet.distance_mm == pytest.approx(lenslet_to_sensor_mm(camera, 587.6), rel=1e-12)


def test_an_array_of_several_types_has_the_mean_of_their_errors() -> None:
    scene = lf.load(asset_path("scenes/diffraction.toml"))
    lists = [[0.056], [0.05], [0.056, 0.05]]

    def error(focal_mm: list[float]) -> float:
        changes = {"camera.mla.focal_length_mm": focal_mm, "camera.mla.layout": "hexagonal"}
        changes["camera.sensor.distance_mm"] = 0.035
        camera = lf.solved(scene.changed(changes)).camera
        return error_on_true_faces(camera, 587.6, 4.0) or math.nan

    one, other, both = (error(each) for each in lists)
    assert both == pytest.approx(0.5 * (one + other), rel=1e-9)
    assert one != pytest.approx(other, rel=0.1)


@pytest.mark.parametrize(
    "change",
    [{"clear_diameter_mm": 0.012}, {"cylinder_axis": "x"}, {"pitch_mm": 0.16, "focal_length_mm": 0.64}],
)
def test_none_is_stated_of_apertures_and_faces_that_are_not_computed(change: dict[str, Any]) -> None:
    """The last of a Fresnel number of 17, which takes too long."""
    scene = lf.load(asset_path("scenes/diffraction.toml"))
    assert error_on_true_faces(lf.solved(scene).camera, 587.6, 4.0) is not None
    changed = scene.changed({f"camera.mla.{key}": value for key, value in change.items()})
    assert error_on_true_faces(lf.solved(changed).camera, 587.6, 4.0) is None
