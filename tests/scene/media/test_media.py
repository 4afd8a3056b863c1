"""Media of a scene file, and what is refused of them."""

import pytest

from lfmesh.errors import SceneError
from lfmesh.scene import Medium, Scene, first_order
from tests.cameras import camera_without_array


def test_a_grid_may_be_given_by_its_path() -> None:
    medium = Medium(grid="flame.npz")  # type: ignore[arg-type]
    assert medium.grid is not None
    assert medium.grid.file == "flame.npz"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"absorption_per_mm": -0.1}, "absorption_per_mm"),
        ({"absorption_per_mm": float("nan")}, "absorption_per_mm"),
        ({"absorption_per_mm": {"wavelengths_nm": [400.0, 700.0], "values": [0.1, -0.2]}}, "-0.2 at 700 nm"),
        ({"absorption_per_mm": 0.1, "emission_w_mm3_sr": 1.0, "temperature_k": 1500.0}, "give one of them"),
        ({"emission_w_mm3_sr": 1.0}, "infinitely bright"),
        ({}, "has no effect on light"),
        ({"bounds": {"kind": "sphere", "radius_mm": 1.0}, "temperature_k": 1500.0}, "needs absorption_per_mm"),
    ],
)
def test_impossible_media_are_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Medium(**values)  # type: ignore[arg-type]


def test_a_medium_that_shines_is_no_reason_for_a_black_image() -> None:
    def said(**medium: object) -> str:
        values = {"bounds": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": [0.0, 0.0, -150.0], **medium}
        return " ".join(first_order(Scene(camera=camera_without_array(), media=[values])).warnings)  # type: ignore[arg-type]

    assert "will be black" in said(absorption_per_mm=0.1)
    assert "will be black" in said(scattering_per_mm=0.1)
    assert "will be black" not in said(emission_w_mm3_sr=1e-8)
