"""Make the voxel grid of a candle-like soot flame, assets/volumes/flame.npz, from formulas.

Height h runs from the wick, radius r from the axis (mm). Soot fills the flame's mantle, whose radius swells and closes
to a tip; it is hottest at its outside. What soot absorbs follows Rayleigh's limit, κ = 6π E f / λ with E = 0.26, and
the flame emits κ times Planck's radiance through a filter of 10 nm at 589 nm.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.cie import planck_radiance

PLACE = Path(__file__).resolve().parents[1] / "assets" / "volumes" / "flame.npz"
HEIGHT_MM, WIDTH_MM = 48.0, 8.0
SPACING_MM = 0.5
LINE_NM, FILTER_NM = 589.0, 10.0
ABSORPTION_FUNCTION = 0.26
MOST_SOOT = 1.5e-6
"""Volume fraction."""


def soot_and_temperature(
    r: NDArray[np.float64], h: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the volume fraction of soot and the temperature in K at radius r and height h, mm."""
    s = np.clip(h / HEIGHT_MM, 0.0, 1.0)
    edge = WIDTH_MM * 2.6 * s**0.55 * (1.0 - s) ** 0.85 + 1e-3
    u = r / edge
    mantle = np.exp(-(((u - 0.45) / 0.28) ** 2)) + 0.55 * np.exp(-((u / 0.45) ** 2)) * s
    cut = np.clip(1.15 - u, 0.0, 0.3) / 0.3
    soot = MOST_SOOT * mantle * cut * np.clip((s - 0.08) / 0.25, 0.0, 1.0) * np.clip((1.0 - s) / 0.1, 0.0, 1.0)
    temperature = 1250.0 + 550.0 * np.exp(-(((u - 0.85) / 0.5) ** 2)) * (1.0 - 0.35 * s)
    return soot, temperature


def main() -> None:
    """Write the grid."""
    across = np.arange(-14.0, 14.0 + 0.5 * SPACING_MM, SPACING_MM)
    up = np.arange(0.0, HEIGHT_MM + 0.5 * SPACING_MM, SPACING_MM)
    r = np.hypot(across[:, None, None], across[None, None, :])
    soot, temperature = soot_and_temperature(r, up[None, :, None])
    absorption = 6e6 * np.pi * ABSORPTION_FUNCTION * soot / LINE_NM
    radiance = FILTER_NM * np.vectorize(lambda t: float(planck_radiance(LINE_NM, t)))(np.round(temperature, 1))
    PLACE.parent.mkdir(exist_ok=True)
    np.savez_compressed(
        PLACE,
        absorption_per_mm=_short(absorption),
        emission_w_mm3_sr=_short(1e-6 * absorption * radiance),
        spacing_mm=np.full(3, SPACING_MM),
        origin_mm=np.array([across[0], up[0], across[0]]),
    )


def _short(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return numbers with eleven bits of mantissa, which compress well."""
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(mantissa * 2048.0) / 2048.0, exponent).astype(np.float32)


if __name__ == "__main__":
    main()
