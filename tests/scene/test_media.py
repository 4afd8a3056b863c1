"""Media of a scene file, and what is refused of them."""

import pytest

from lfmesh.errors import SceneError
from lfmesh.scene import Medium


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
        ({}, "does nothing to light"),
        ({"bounds": {"kind": "sphere", "radius_mm": 1.0}, "temperature_k": 1500.0}, "needs absorption_per_mm"),
    ],
)
def test_impossible_media_are_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Medium(**values)  # type: ignore[arg-type]
