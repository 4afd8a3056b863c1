"""Make the voxel grid of a hot plume above a burner, assets/volumes/plume.npz, from a formula.

Height h runs upwards from the burner, radius r from the axis (mm). The profile of the temperature is a Gaussian, as in
laminar plumes far from their source. It widens with the height, and the excess over the room falls.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PLACE = Path(__file__).resolve().parents[1] / "assets" / "volumes" / "plume.npz"
HALF_WIDTH_MM, HEIGHT_MM = 30.0, 90.0
SPACING_MM = 1.25
ROOM_K, EXCESS_K = 293.15, 300.0
MANTISSA = 2.0**17
"""Steps of the mantissa: few enough to compress well, and too many to bend light."""


def temperature_k(r: NDArray[np.float64], h: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the temperature at radius r and height h, mm."""
    radius = 10.0 + 0.04 * h
    return ROOM_K + EXCESS_K / (1.0 + h / 60.0) * np.exp(-((r / radius) ** 2))


def main() -> None:
    """Write the grid."""
    across = np.arange(-HALF_WIDTH_MM, HALF_WIDTH_MM + 0.5 * SPACING_MM, SPACING_MM)
    up = np.arange(0.0, HEIGHT_MM + 0.5 * SPACING_MM, SPACING_MM)
    r = np.hypot(across[:, None, None], across[None, None, :])
    mantissa, exponent = np.frexp(temperature_k(r, up[None, :, None]))
    PLACE.parent.mkdir(exist_ok=True)
    np.savez_compressed(
        PLACE,
        temperature_k=np.ldexp(np.round(mantissa * MANTISSA) / MANTISSA, exponent).astype(np.float32),
        spacing_mm=np.full(3, SPACING_MM),
        origin_mm=np.array([across[0], up[0], across[0]]),
    )


if __name__ == "__main__":
    main()
