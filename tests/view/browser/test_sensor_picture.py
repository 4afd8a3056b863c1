"""The sensor's picture in the page: what is shown where, upright, whatever part of it is looked at."""

from collections.abc import Callable

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.lightfield.calibration.calibration import calibrate
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene
from lfmesh.view.browser.sensor_picture import SensorPicture

COLUMNS, ROWS = 150, 130

INVERTED, ERECT = Upright(inverts=True), Upright(inverts=False)
BOTH = pytest.mark.parametrize(
    ("upright", "bright"), [(INVERTED, (98, 104)), (ERECT, (31, 45))], ids=["inverting lens", "relay"]
)
"""Row and column of the one pixel that got light, such that its light came from the same place of the scene.

Seen from behind the camera, that is left of the middle and below it, −x and −y: so it fell on pixels at +x and +y, the
last columns and rows, of the sensor of a lens that inverts, and on those at −x, −y behind one that does not.
"""
SEEN = (98, 45)
"""Row and column of the upright picture where it belongs, towards the left and the bottom."""


def whole(_: SensorPicture) -> None:
    pass


def enlarged(picture: SensorPicture) -> None:
    picture.zoom(0.3, 0.75, 4.0)


def moved(picture: SensorPicture) -> None:
    picture.zoom(0.5, 0.5, 3.0)
    picture.move(0.3, -0.9)


def as_near_as_it_goes(picture: SensorPicture) -> None:
    picture.zoom(0.305, 0.758, 1e6)


@BOTH
@pytest.mark.parametrize("look", [whole, enlarged, moved, as_near_as_it_goes])
def test_a_place_is_the_pixel_that_is_seen_there(
    upright: Upright, bright: tuple[int, int], look: Callable[[SensorPicture], None], camera: Callable[[], Scene],
    image_of: Callable[..., lf.Image],
) -> None:  # fmt: skip
    light = np.zeros((ROWS, COLUMNS))
    light[bright] = 1.0
    picture = SensorPicture(COLUMNS, ROWS, upright, image_of(camera(), light))
    look(picture)
    shown = picture.pixels_shown()
    height, width = shown.shape
    assert (height, width) == (picture.part.height, picture.part.width)
    ((y, x),) = np.argwhere(shown)
    assert (y + picture.part.row, x + picture.part.column) == SEEN
    assert picture.pixel((x + 0.5) / width, (y + 0.5) / height) == bright
    row, column = bright
    left, top, across, down = picture.box(range(row, row + 1), range(column, column + 1))
    assert [left * width, top * height, across * width, down * height] == pytest.approx([x, y, 1.0, 1.0])


def test_a_box_holds_the_pixels_between_its_corners(camera: Callable[[], Scene]) -> None:
    picture = SensorPicture(COLUMNS, ROWS, INVERTED)
    enlarged(picture)
    rows, columns = picture.pixels(0.71, 0.2, 0.33, 0.9)
    assert rows.start == picture.pixel(0.71, 0.2)[0]
    assert rows.stop - 1 == picture.pixel(0.33, 0.9)[0]
    assert columns.start == picture.pixel(0.71, 0.2)[1]
    assert columns.stop - 1 == picture.pixel(0.33, 0.9)[1]
    left, top, across, down = picture.box(rows, columns)
    # The box grows to whole pixels.
    assert left == pytest.approx(0.33, abs=1.0 / picture.part.width)
    assert top == pytest.approx(0.2, abs=1.0 / picture.part.height)
    assert across == pytest.approx(0.38, abs=2.0 / picture.part.width)
    assert down == pytest.approx(0.7, abs=2.0 / picture.part.height)


def test_zooming_keeps_what_is_under_the_mouse() -> None:
    picture = SensorPicture(COLUMNS, ROWS, INVERTED)
    under = picture.pixel(0.3, 0.6)
    for _ in range(4):
        picture.zoom(0.3, 0.6, 1.5)
        row, column = picture.pixel(0.3, 0.6)
        assert abs(row - under[0]) <= 2
        assert abs(column - under[1]) <= 2
    assert picture.part.width < 0.25 * COLUMNS
    picture.zoom(0.9, 0.9, 1e-6)
    assert picture.part == picture.all


@pytest.mark.parametrize("upright", [INVERTED, ERECT], ids=["inverting lens", "relay"])
def test_marks_lie_on_the_centres_of_the_micro_images(upright: Upright, camera: Callable[[], Scene]) -> None:
    """Of an array that is mounted aside, so that no turn of its centres is the same as the centres."""
    calibration = calibrate(camera().changed({"camera.mla.pose.shift_mm": (0.03, -0.02, 0.0)}))
    picture = SensorPicture(COLUMNS, ROWS, upright, None, calibration)
    enlarged(picture)
    marks = picture.centres_shown()
    assert 0 < len(marks) < calibration.known.sum()
    for x, y in marks:
        row, column = picture.pixel(x, y)
        off = np.abs(calibration.centres_px - [column, row]).max(axis=-1)
        assert off.min() <= 0.5 + 1e-9, "in the pixel that holds the centre"


def test_at_first_the_part_that_is_lit_is_shown(camera: Callable[[], Scene], image_of: Callable[..., lf.Image]) -> None:
    scene, mean = camera(), np.full((ROWS, COLUMNS), 1e-15)
    mean[90:110, 20:50] = 1e-12
    picture = SensorPicture(COLUMNS, ROWS, INVERTED, image_of(scene, mean))
    picture.lit()
    # Upright the columns are reversed: 100 to 130.
    part = picture.part
    assert part.row < 90 <= 110 <= part.row + part.height
    assert part.column < 100 <= 130 <= part.column + part.width
    assert part.height * part.width < 4 * 20 * 30
    left, top, width, height = picture.box(range(90, 110), range(20, 50))
    assert 0.0 < left < left + width < 1.0
    assert 0.0 < top < top + height < 1.0
    picture.whole()
    assert picture.part == picture.all


@pytest.mark.parametrize("level", [0.0, 1e-12])
def test_a_sensor_lit_everywhere_or_nowhere_is_shown_whole(
    level: float, camera: Callable[[], Scene], image_of: Callable[..., lf.Image]
) -> None:
    picture = SensorPicture(COLUMNS, ROWS, INVERTED, image_of(camera(), np.full((ROWS, COLUMNS), level)))
    picture.lit()
    blank = SensorPicture(COLUMNS, ROWS, INVERTED)
    blank.lit()
    assert picture.part == blank.part == picture.all
