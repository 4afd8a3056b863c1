"""Rays through phase surfaces in as many digits as mpmath works with: sags and phases are all that it is told."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mpmath as mp
import numpy as np
from numpy.typing import NDArray

Vector = list[Any]
Function = Callable[[Any, Any], Any]


def rotation(tilt_deg: list[float]) -> Any:
    """Return the matrix of rotations about x, then y, then z."""
    turn = mp.eye(3)
    for axis, degrees in enumerate(tilt_deg):
        angle = mp.mpf(degrees) * mp.pi / 180
        c, s = mp.cos(angle), mp.sin(angle)
        one = mp.eye(3)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        one[i, i], one[j, j], one[i, j], one[j, i] = c, c, -s, s
        turn = one * turn
    return turn


@dataclass
class Face:
    """A surface of the truth.

    Attributes
    ----------
    z : mpf, mm
        Vertex before the pose, which turns about the origin.
    sag, phase : callable of x and y
        mm and rad.
    before, behind : mpf
        Refractive indices.
    order : int
    turn, shift
        Pose.
    """

    z: Any
    sag: Function
    before: Any
    behind: Any
    phase: Function | None = None
    order: int = 1
    turn: Any = None
    shift: Vector = field(default_factory=lambda: [mp.mpf(0)] * 3)

    def into(self, vector: Vector) -> Vector:
        """Return a vector in the frame of the surface's element."""
        return vector if self.turn is None else list(self.turn.T * mp.matrix(vector))

    def out(self, vector: Vector) -> Vector:
        """Return a vector of that frame in the camera's."""
        return vector if self.turn is None else list(self.turn * mp.matrix(vector))

    def pass_ray(self, p: Vector, d: Vector, nm: float) -> tuple[Vector, Vector, Any]:
        """Return point and direction behind the surface, and the transmittance."""
        q = self.into([a - s for a, s in zip(p, self.shift, strict=True)])
        e = self.into(d)
        q[2] -= self.z

        def above(t: Any) -> Any:
            return q[2] + t * e[2] - self.sag(q[0] + t * e[0], q[1] + t * e[1])

        near = -q[2] / e[2]
        t = mp.findroot(above, (near, near + mp.mpf("1e-3")))
        at = [a + t * b for a, b in zip(q, e, strict=True)]
        x, y = at[:2]
        normal = unit([-mp.diff(self.sag, (x, y), (1, 0)), -mp.diff(self.sag, (x, y), (0, 1)), mp.mpf(1)])
        cos_i = dot(e, normal)
        along = [self.before * (a - cos_i * n) for a, n in zip(e, normal, strict=True)]
        share = transmittance(self.before, self.behind, dot(along, along))
        if self.phase is not None:
            scale = self.order * mp.mpf(nm) * mp.mpf("1e-6") / (2 * mp.pi)
            step = [scale * mp.diff(self.phase, (x, y), n) for n in ((1, 0), (0, 1))] + [mp.mpf(0)]
            lifted = dot(step, normal)
            along = [a + g - lifted * n for a, g, n in zip(along, step, normal, strict=True)]
        root = mp.sqrt(self.behind**2 - dot(along, along))
        bent = [(a + root * n) / self.behind for a, n in zip(along, normal, strict=True)]
        at[2] += self.z
        return [a + s for a, s in zip(self.out(at), self.shift, strict=True)], self.out(bent), share


def through_faces(
    faces: list[Face], origin: NDArray[np.float64], direction: NDArray[np.float64], nm: float, sensor_z: float
) -> tuple[list[float], list[float], float]:
    """Return position on the plane of the sensor, direction and weight of a ray.

    Parameters
    ----------
    faces : list of Face
    origin : (3,) float64, mm
    direction : (3,) float64
    nm : float
        Wavelength in air.
    sensor_z : float, mm
    """
    p, d = [mp.mpf(float(a)) for a in origin], unit([mp.mpf(float(a)) for a in direction])
    weight = mp.mpf(1)
    for face in faces:
        p, d, share = face.pass_ray(p, d, nm)
        weight *= share
    t = (mp.mpf(sensor_z) - p[2]) / d[2]
    return [float(a + t * b) for a, b in zip(p, d, strict=True)], [float(b) for b in d], float(weight)


def transmittance(before: Any, behind: Any, along2: Any) -> Any:
    """Return Fresnel's transmittance for unpolarised light, by the square of n sin θ."""
    a, b = (mp.sqrt(n * n - along2) for n in (before, behind))
    r_s, r_p = (a - b) / (a + b), (behind**2 * a - before**2 * b) / (behind**2 * a + before**2 * b)
    return 1 - (r_s**2 + r_p**2) / 2


def dot(a: Vector, b: Vector) -> Any:
    return mp.fsum(x * y for x, y in zip(a, b, strict=True))


def unit(a: Vector) -> Vector:
    length = mp.sqrt(dot(a, a))
    return [x / length for x in a]
