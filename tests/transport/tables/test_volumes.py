"""Tables of media: the power by which emitting ones start packets and are drawn."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from tests.cameras import camera_without_array
from tests.transport.events.test_volume import volumes_of as without_bands

BALL: dict[str, Any] = {"bounds": {"kind": "sphere", "radius_mm": 3.0}, "position_mm": [0.0, 0.0, -60.0]}


def line_at(nm: float) -> dict[str, list[float]]:
    """Return a spectrum with a line, 8 nm wide, and nothing else."""
    return {"wavelengths_nm": [200.0, nm - 4.0, nm, nm + 4.0, 1200.0], "values": [0.0, 0.0, 1.0, 0.0, 0.0]}


def volumes_of(medium: dict[str, Any], folder: Path) -> Any:
    scene = lf.Scene(camera=camera_without_array()).changed({"camera.sensor.bands": "rgb", "media": [medium]})
    return lf.build(scene.in_folder(folder), aimed=False).tables.objects.volumes


@pytest.mark.parametrize("nm", [546.1, 589.0], ids=["mercury", "sodium"])
@pytest.mark.parametrize("kind", ["uniform", "grid", "temperature"])
def test_the_power_of_a_narrow_line_is_the_mean_over_all_wavelengths(kind: str, nm: float, tmp_path: Path) -> None:
    """Of the many wavelengths of three bands a few show the line; some of all may hold none of these."""
    if kind == "uniform":
        medium = BALL | {"emission_w_mm3_sr": 1.0, "spectrum": line_at(nm)}
    elif kind == "grid":
        np.savez(tmp_path / "g.npz", emission_w_mm3_sr=np.ones((2, 2, 2)), spacing_mm=[2.0, 2.0, 2.0])
        medium = {"grid": {"file": "g.npz"}, "position_mm": [0.0, 0.0, -60.0], "spectrum": line_at(nm)}
    else:
        medium = BALL | {"temperature_k": 2000.0, "absorption_per_mm": line_at(nm)}
    volumes = volumes_of(medium, tmp_path)
    emission = volumes.emission[0] * (volumes.absorption[0] if kind == "temperature" else 1.0)
    assert 0 < (emission > 0.0).sum() <= 8
    box_mm3 = float(np.prod(volumes.rows["high"][0] - volumes.rows["low"][0]))
    assert volumes.powers[0] == pytest.approx(4e-6 * np.pi * emission.mean() * box_mm3, rel=1e-12)


HOT = {"position_mm": [0.0, 0.0, -100.0], "pressure_kpa": 101.3}


def test_the_temperature_of_air_that_absorbs_nothing_is_no_emission(tmp_path: Path) -> None:
    """It sets the index alone, by a key or in the grid, and needs no bands."""
    np.savez(tmp_path / "hot.npz", temperature_k=np.full((2, 2, 2), 1500.0), spacing_mm=1.0)
    np.savez(tmp_path / "press.npz", pressure_kpa=np.full((2, 2, 2), 99.0), spacing_mm=1.0)
    box = {"kind": "box", "size_mm": [2.0, 2.0, 2.0]}
    for medium in (
        HOT | {"grid": "hot.npz"},
        HOT | {"bounds": box, "temperature_k": 1500.0},
        {"position_mm": [0.0, 0.0, -100.0], "grid": "press.npz", "temperature_k": 1500.0},
    ):
        volumes = without_bands(medium, folder=tmp_path)
        assert not volumes.emit
        assert not volumes.powers.any()
        assert len(volumes.values) == 0, "voxels that are not read"


@pytest.mark.parametrize("more", [{}, {"pressure_kpa": 101.3}])
def test_the_temperature_of_a_gas_that_absorbs_needs_bands(tmp_path: Path, more: dict[str, float]) -> None:
    ones = np.ones((2, 2, 2))
    np.savez(tmp_path / "soot.npz", absorption_per_mm=ones, temperature_k=1500.0 * ones, spacing_mm=1.0)
    np.savez(tmp_path / "smoke.npz", absorption_per_mm=ones, spacing_mm=1.0)
    for grid, key in (("soot.npz", {}), ("smoke.npz", {"temperature_k": 1500.0})):
        medium = {"grid": grid, "position_mm": [0.0, 0.0, -100.0]} | key | more
        with pytest.raises(SceneError, match=r"temperature_k:? needs camera\.sensor\.bands"):
            without_bands(medium, folder=tmp_path)


def test_a_temperature_without_absorption_or_pressure_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "fog.npz", scattering_per_mm=np.ones((2, 2, 2)), spacing_mm=1.0)
    medium = {"grid": "fog.npz", "position_mm": [0.0, 0.0, -100.0], "temperature_k": 1500.0}
    with pytest.raises(SceneError, match=r"media\[0\]\.temperature_k: needs absorption_per_mm"):
        volumes_of(medium, tmp_path)
