"""Make the voxel grid of the hot gas above a slot burner, assets/volumes/plume.npz, from a formula.

Height h runs upwards from the burner, x across its slot and z along it (mm). The profile across the slot is a Gaussian,
as in laminar plumes far from their source. It widens with the height, and the excess over the room falls.
"""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

PLACE = Path(__file__).resolve().parents[1] / "assets" / "volumes" / "plume.npz"
HALF_SIZE_MM, HEIGHT_MM = (30.0, 120.0), 90.0
"""Half the size across and along the slot, and the height, of the grid."""

SPACING_MM = (0.75, 2.5, 4.8)
SLOT_MM = 75.0
"""Half the length of the slot."""

ROOM_K, EXCESS_K = 293.15, 1200.0
MANTISSA = 2.0**17
"""Steps of the mantissa: few enough to compress well, and too many to bend light."""


def temperature_k(x: ArrayLike, h: ArrayLike, z: ArrayLike) -> NDArray[np.float64]:
    """Return the temperature at places across the slot, heights, and places along the slot.

    Parameters
    ----------
    x, h, z : (...) array_like, mm
    """
    x, h, z = (np.asarray(each, np.float64) for each in (x, h, z))
    radius = 8.0 + 0.04 * h
    return np.asarray(ROOM_K + EXCESS_K / (1.0 + h / 60.0) * np.exp(-((x / radius) ** 2) - (z / SLOT_MM) ** 4))


def main() -> None:
    """Write the grid."""
    half, spacing = (HALF_SIZE_MM[0], 0.5 * HEIGHT_MM, HALF_SIZE_MM[1]), SPACING_MM
    counts = [round(2.0 * size / step) + 1 for size, step in zip(half, spacing, strict=True)]
    x, h, z = (step * (np.arange(count) - 0.5 * (count - 1)) for count, step in zip(counts, spacing, strict=True))
    h += half[1]
    mantissa, exponent = np.frexp(temperature_k(x[:, None, None], h[None, :, None], z[None, None, :]))
    PLACE.parent.mkdir(exist_ok=True)
    np.savez_compressed(
        PLACE,
        temperature_k=np.ldexp(np.round(mantissa * MANTISSA) / MANTISSA, exponent).astype(np.float32),
        spacing_mm=np.array(spacing),
        origin_mm=np.array([x[0], h[0], z[0]]),
    )


if __name__ == "__main__":
    main()
