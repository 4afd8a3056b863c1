"""Index fields in closed form, as kernels: rays through them have no error of interpolation."""

from typing import Any

import mpmath as mp
import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined
from lfmesh.optics.index_field_path import follower
from lfmesh.optics.index_fields import INDEX_FIELD, LEAPFROG

Array = NDArray[np.float64]

BALL, HARMONIC, LINEAR, LAYER = range(4)
DIGITS = 30


@inlined
def closed_at(fields: Array, number: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return n² and ½ ∇n².

    BALL: n = 1 + δ exp(−r²/w²). HARMONIC: n² = n₀² − gx² x² − gy² y² − gz² z². LINEAR: n² = n₀² + 2 a y.
    LAYER: n² = n₀² − A exp(−y/l).
    """
    row = fields[number]
    kind = int(row[0])
    if kind == BALL:
        bump = row[1] * np.exp(-(x * x + y * y + z * z) / (row[2] * row[2]))
        n = 1.0 + bump
        rate = -2.0 * n * bump / (row[2] * row[2])
        return n * n, rate * x, rate * y, rate * z
    if kind == HARMONIC:
        ax, ay, az = row[2] * row[2], row[3] * row[3], row[4] * row[4]
        return row[1] * row[1] - ax * x * x - ay * y * y - az * z * z, -ax * x, -ay * y, -az * z
    if kind == LINEAR:
        return row[1] * row[1] + 2.0 * row[2] * y, 0.0, row[2], 0.0
    bump = row[2] * np.exp(-y / row[3])
    return row[1] * row[1] - bump, 0.0, 0.5 * bump / row[3], 0.0


_follow_closed = follower(closed_at)


def box(size: Any, step: float, scheme: int = LEAPFROG, low: Any = None) -> NDArray[np.void]:
    """Return a box of voxels of 1 mm, centred on the origin unless its lowest corner is given."""
    rows = np.zeros(1, INDEX_FIELD)
    extent = np.broadcast_to(np.asarray(size, np.float64), (3,))
    rows["low"] = -0.5 * extent if low is None else low
    rows["high"] = rows["low"] + extent
    rows["per_mm"], rows["scheme"], rows["step"] = 1.0, scheme, step
    rows["slabs"] = np.ceil(extent / step)
    return rows


def start(field: Array, points: Any, directions: Any) -> Array:
    """Return rays at points in a field, (n, 8)."""
    at, along = (np.array(part, np.float64).reshape(-1, 3) for part in (points, directions))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    n2 = [closed_at(field[None], 0, *point)[0] for point in at]
    return np.hstack([at, np.sqrt(n2)[:, None] * along, np.zeros((len(at), 2))])


def followed(field: Array, boxes: NDArray[np.void], rays: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the exit faces and the rays there."""
    ends, faces = np.array(rays), np.full(len(rays), -9)
    _follow_closed(field[None], boxes, 0, ends, faces, None)
    return faces, ends


def field(kind: int, *numbers: float) -> Array:
    """Return the row of a field in closed form."""
    return np.array([kind, *numbers, *[0.0] * (4 - len(numbers))])


def ball_deflection(delta: float, width: float, impact: float) -> float:
    """Return the deflection by a ball, towards its centre for δ > 0, in 30 digits.

    By Bouguer's law n r sin θ = b of spherical fields, it is −2 b ∫ (n'/n) dr/√(n² r² − b²) from the nearest point r₀.
    With r = r₀ + u², the integrand is even in u, smooth, and fades: the midpoint rule converges exponentially.
    """
    with mp.workdps(2 * DIGITS):
        nearest, index, root = _bouguer(delta, width, impact)
        step = mp.sqrt(width) / 64

        def bend(u: Any) -> Any:
            r = nearest + u * u
            n = index(r)
            return 2 * r / mp.mpf(width) ** 2 * (n - 1) / n * root(u)

        total = mp.fsum(bend((k + mp.mpf(1) / 2) * step) for k in range(64 * 4))
        return float(2 * mp.mpf(impact) * step * total)


def ball_path(delta: float, width: float, impact: float, radius: float) -> float:
    """Return the optical path through a ball from the radius to the radius, 2 ∫ n² r dr/√(n² r² − b²)."""
    with mp.workdps(2 * DIGITS):
        nearest, index, root = _bouguer(delta, width, impact)
        end = mp.sqrt(radius - nearest)

        def along(u: Any) -> Any:
            r = nearest + u * u
            return index(r) ** 2 * r * root(u)

        return float(2 * mp.quad(along, mp.linspace(mp.mpf(10) ** -DIGITS, end, 7), method="gauss-legendre"))


def _bouguer(delta: float, width: float, impact: float) -> tuple[Any, Any, Any]:
    """Return r₀, n(r), and the product of dr/du and 1/√(n² r² − b²) as a function of u."""

    def index(r: Any) -> Any:
        return 1 + mp.mpf(delta) * mp.exp(-((r / mp.mpf(width)) ** 2))

    b = mp.mpf(impact)
    nearest = mp.findroot(lambda r: r * index(r) - b, b)

    def root(u: Any) -> Any:
        r = nearest + u * u
        return 2 / mp.sqrt(((index(r) * r) ** 2 - b * b) / (u * u))

    return nearest, index, root


def in_duct(ray: Array, rates: Array, sigma: Any) -> Array:
    """Return the position and T of a ray in n² = n₀² − Σ g² x², in 30 digits: harmonic in σ."""
    with mp.workdps(DIGITS):
        at, along = [], []
        for r, t, g in zip(ray[:3].tolist(), ray[3:6].tolist(), rates.tolist(), strict=True):
            r, t, g = mp.mpf(r), mp.mpf(t), mp.mpf(g)
            at.append(r * mp.cos(g * sigma) + (t * mp.sin(g * sigma) / g if g else t * sigma))
            along.append(t * mp.cos(g * sigma) - g * r * mp.sin(g * sigma))
        return np.array([*at, *along], np.float64)


def over_hot_plate(ray: Array, strength: float, height: float, sigma: Any) -> tuple[float, float]:
    """Return y and T_y in n² = n₀² − A exp(−y/l).

    With E = T_y² + A exp(−y/l), which is constant, exp(y/2l) = √(A/E) cosh(√E (σ − σ₀)/2l).
    """
    with mp.workdps(DIGITS):
        y, t, a, el = mp.mpf(ray[1]), mp.mpf(ray[4]), mp.mpf(strength), mp.mpf(height)
        energy = t * t + a * mp.exp(-y / el)
        rate = mp.sqrt(energy) / (2 * el)
        phase = rate * sigma + mp.atanh(t / mp.sqrt(energy))
        bottom = 2 * el * mp.log(mp.sqrt(a / energy) * mp.cosh(phase))
        return float(bottom), float(mp.sqrt(energy) * mp.tanh(phase))


def in_linear_index(ray: Array, index: float, slope: float, length: float) -> tuple[Array, float]:
    """Return position and T, (6,), and the length of the path of a ray in n = n₀ + b y, at a distance along z.

    As a function of σ, n is a hyperbolic cosine: d²n/dσ² = b² n. The other components of T are constant.

    Parameters
    ----------
    ray : (6 or more,) float
        Position, mm, and T at the start.
    index, slope : float
        n₀, and b in mm⁻¹.
    length : float, mm
    """
    with mp.workdps(DIGITS):
        x, y, z, tx, ty, tz = (mp.mpf(each) for each in ray[:6].tolist())
        b = mp.mpf(slope)
        n, sigma = mp.mpf(index) + b * y, mp.mpf(length) / tz
        cosh, sinh = mp.cosh(b * sigma), mp.sinh(b * sigma)
        behind = n * cosh + ty * sinh
        end = [x + tx * sigma, (behind - mp.mpf(index)) / b, z + length, tx, n * sinh + ty * cosh, tz]
        return np.array(end, np.float64), float((n * sinh + ty * (cosh - 1)) / b)
