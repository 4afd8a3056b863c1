"""Rays from the sensor through a lenslet's face: their slope, and their spread on the face.

Air stands for the medium outside the plate, whatever it is; indices of the plate are relative to it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import ROW_SPACING, Lattice, half_hexagon
from lfmesh.geometry.array.lenslet_profile import is_steeper, next_fall, profile_shape
from lfmesh.geometry.array.lenslets import Lenslets
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.tables.tables import AIR, MlaTables

Array = NDArray[np.float64]

_TINY = float(np.finfo(np.float64).tiny)

STEPS = 40
"""Largest number of Newton steps towards a slope."""

THIRD_ORDER = 0.1
"""Largest correction by third order, relative to the slope of first order."""

EXACT = 1e-4
"""Relative size of the last Newton step; the remaining error is its square."""

_CORNERS = (
    (0.5, 0.5 / np.sqrt(3.0)),
    (-0.5, 0.5 / np.sqrt(3.0)),
    (0.0, -1.0 / np.sqrt(3.0)),
    (0.5, 0.5 / np.sqrt(3.0)),
)
"""Every second corner of a hexagon of width 1, and the first again."""


@inlined
def solid_angle(r: float, air: float, plate: float, glass: float) -> float:
    """Return the projected solid angle of an area in the apex plane, relative to one straight ahead.

    Zero where no ray arrives: for a sensor that touches the glass, beyond the angle of total reflection.

    Parameters
    ----------
    r : float, mm
        Lateral distance of the area.
    air, plate : float, mm
        Thickness of air and glass in between.
    glass : float
        Refractive index.
    """
    s = slope_to(r, air, plate, glass)
    s2 = s * s
    q2 = glass * glass + (glass * glass - 1.0) * s2
    ahead = (air + plate / glass) ** 2
    seen = ahead / (spread_on_face(air, plate, glass, s2, q2, np.sqrt(q2), 1.0) * np.sqrt(1.0 + s2))
    # There the slope is infinite and the quotient 0/0.
    return seen if seen > 0.0 else 0.0


@inlined
def glass_before_faces(mla: MlaTables, colour: int) -> float:
    """Return the relative index of the plate between sensor and lenslet faces to the medium outside; 1 without it."""
    return mla.media.indices[mla.medium, colour] / mla.media.indices[AIR, colour] if mla.curved_to_lens else 1.0


@inlined
def path_to_apexes(mla: MlaTables, z: float) -> tuple[float, float, float]:
    """Return the thickness of air and glass (mm) between the height z over the array and the apexes.

    The third value is the change of the glass thickness per sag of the face. Without glass in between, it applies to
    the air, which then counts as glass of index 1.
    """
    if mla.curved_to_lens:
        return abs(z - mla.lenslets.thickness), mla.lenslets.thickness, -1.0
    return abs(z), 0.0, 1.0


@inlined
def lenslet_ahead(mla: MlaTables, glass: float, z: float) -> float:
    """Return the solid angle, sr, of a lenslet straight ahead from the height z (array frame).

    Parameters
    ----------
    mla : MlaTables
    glass : float
        See `glass_before_faces`.
    z : float, mm
    """
    lattice = mla.lenslets.lattice
    air, plate, _ = path_to_apexes(mla, z)
    reduced = air + plate / glass
    filled = ROW_SPACING if lattice.hexagonal else 1.0
    return filled * lattice.pitch * lattice.pitch / (reduced * reduced)


@inlined
def slope_to(r: float, air: float, plate: float, glass: float) -> float:
    """Return the slope in air of a ray with a given lateral shift over air and a glass plate.

    Newton's method starts from the third-order slope; one step is mostly enough. `THIRD_ORDER` limits the third-order
    correction, which is inaccurate for steep rays. The shift is a concave function of the slope, so from the second
    step on the slope converges from below.

    Parameters
    ----------
    r : float, mm
        Lateral shift.
    air, plate : float, mm
        Thickness of air and glass.
    glass : float
        Refractive index.
    """
    more = glass * glass - 1.0
    s = r / (air + plate / glass)
    s += s * min(0.5 * s * s * plate * more / (glass * glass * (air * glass + plate)), THIRD_ORDER)
    for _ in range(STEPS):
        q2 = glass * glass + more * s * s
        q = np.sqrt(q2)
        step = (r - s * air - plate * s / q) / (air + plate * glass * glass / (q * q2))
        s += step
        if abs(step) <= EXACT * s:
            break
    return s


@inlined
def on_face(curvature: float, ax: float, ay: float, gx: float, gy: float) -> tuple[bool, float, float, float, float]:
    """Return whether the line (a + g z, z) passes a cap with its apex at the origin, the point, and 1 − g · ∇sag.

    Only the crossing from inside the sphere, on the half with the apex, is a ray through the face.

    Parameters
    ----------
    curvature : float, 1/mm
    ax, ay : float, mm
    gx, gy : float
    """
    g2, a2, b = gx * gx + gy * gy, ax * ax + ay * ay, 1.0 - curvature * (ax * gx + ay * gy)
    root2 = b * b - curvature * curvature * (1.0 + g2) * a2
    if b <= 0.0 or root2 <= 0.0:
        return False, 0.0, 0.0, 0.0, 0.0
    root = np.sqrt(root2)
    z = curvature * a2 / (b + root)
    level = 1.0 - curvature * z
    return level > 0.0, ax + gx * z, ay + gy * z, z, root / max(level, _TINY)


@inlined
def spread_on_face(air: float, plate: float, glass: float, s2: float, q2: float, q: float, turned: float) -> float:
    """Return a face's area, projected along the axis, over the solid angle of its rays in air, mm²/sr.

    Parameters
    ----------
    air, plate : float, mm
        Thickness of air and glass on the way.
    glass : float
        Refractive index.
    s2, q2, q : float
        Squared slope in air; ratio of the slopes in air and in glass, squared, and the ratio itself.
    turned : float
        1 − (slope of the ray · slope of the face): effect of the face's inclination on the projected area.
    """
    across = air + plate / q
    along = air + plate * glass * glass / (q * q2)
    return across * along * (1.0 + s2) * np.sqrt(1.0 + s2) / turned


@inlined
def face_over(
    profile: Any, kind: float, curvature: float, ax: float, ay: float
) -> tuple[bool, float, float, float, float, float]:
    """Return whether a lenslet has a face over a point, its sag there, and its slope.

    The slope along x is the third value times the fourth over the last; along y, the third times the fifth over the
    last. For a sphere the last is the cosine of the inclination.

    Parameters
    ----------
    profile : Profile or None
        None: the lenslet is a sphere.
    kind : float
        Type of the lenslet.
    curvature : float, 1/mm
    ax, ay : float, mm
        Point, relative to the apex.
    """
    if profile is None:
        r2 = ax * ax + ay * ay
        level2 = 1.0 - curvature * curvature * r2
        if level2 <= 0.0:
            return False, 0.0, 0.0, 0.0, 0.0, 1.0
        level = np.sqrt(level2)
        return True, curvature * r2 / (1.0 + level), curvature, ax, ay, level
    rho2 = profile.weight_x * ax * ax + profile.weight_y * ay * ay
    if rho2 > profile.domain * profile.domain:
        return False, 0.0, 0.0, 0.0, 0.0, 1.0
    sag, gx, gy = profile_shape(profile, int(kind), curvature, ax, ay)
    return True, sag, 1.0, gx, gy, 1.0


@inlined
def meets_once(profile: Any, kind: float, sx: float, sy: float, q: float) -> bool:
    """Tell whether a ray crosses its cell's face only once.

    Parameters
    ----------
    profile, kind
        As for `face_over`.
    sx, sy, q : float
        Slopes in air, and their ratio to the slopes at the face.
    """
    if profile is None:
        return True
    return is_steeper(profile, int(kind), sx, sy, q)


@inlined
def on_lenslet(
    lenslets: Lenslets, kind: int, curvature: float, ax: float, ay: float, gx: float, gy: float, from_glass: bool
) -> tuple[bool, float, float]:  # fmt: skip
    """Return whether a line (a + g z, z) passes a lenslet's face, and the point, relative to the apex; see `on_face`.

    Parameters
    ----------
    lenslets : Lenslets
    kind : int
        Type of the lenslet.
    curvature : float, 1/mm
    ax, ay : float, mm
    gx, gy : float
    from_glass : bool
        Of several crossings take the first for a ray in the glass, else the first for a ray in the air.
    """
    return _on_lenslet_by(lenslets.profile, lenslets, kind, curvature, ax, ay, gx, gy, from_glass)


@inlined
def _on_lenslet_by(
    profile: Any, lenslets: Lenslets, kind: int, curvature: float, ax: float, ay: float, gx: float, gy: float,
    from_glass: bool,
) -> tuple[bool, float, float]:  # fmt: skip
    if profile is None:
        met, px, py, _, _ = on_face(curvature, ax, ay, gx, gy)
        return met, px, py
    falls, z, _ = next_fall(profile, kind, curvature, ax, ay, gx, gy, 0.0, lenslets.top, lenslets.valley)
    met, at = falls, z
    while falls and from_glass:
        falls, z, _ = next_fall(profile, kind, curvature, ax, ay, gx, gy, -1.0, at, lenslets.valley)
        if falls:
            at = z
    return met, ax + gx * at, ay + gy * at


@inlined
def half_width_to(lattice: Lattice, x: float, y: float) -> float:
    """Return the half width of a cell about the origin with the point on its border, mm.

    Parameters
    ----------
    lattice : Lattice
    x, y : float, mm
        Relative to the cell's centre.
    """
    return half_hexagon(x, y) if lattice.hexagonal else max(abs(x), abs(y))


@kernel
def point_of_cell(hexagonal: bool, u: float, v: float) -> tuple[float, float]:
    """Return a uniform point of the cell about the origin, in pitches.

    Parameters
    ----------
    hexagonal : bool
    u, v : float
        Random numbers, uniform in [0, 1).
    """
    if not hexagonal:
        return u - 0.5, v - 0.5
    # The hexagon consists of three rhombi, each spanned by two of the radii to the corners at 30°, 150° and 270°.
    third = int(3.0 * u)
    u = 3.0 * u - third
    ax, ay = _CORNERS[third]
    bx, by = _CORNERS[third + 1]
    return u * ax + v * bx, u * ay + v * by
