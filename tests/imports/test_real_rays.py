"""Real rays through imported surfaces against the formulas that define these, with 40 digits and nothing shared."""

from collections.abc import Callable
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest

import lfmesh as lf
from lfmesh.imports import read_lens_file

INDEX, THICKNESS, BEHIND = "1.6", "4", "30"
RADIUS, CONIC, NORM = "25", "-0.4", "6"
EXACT_MM, MILD_MM = 1e-11, 1e-8
"""Forbes' mild aspheres are traced as even ones that lie within 1e-9 mm of them; their slopes differ more."""

FILE = f"""\
MODE SEQ
UNIT MM
ENPD 8
FTYP 0 0 1 1
YFLN 0
WAVM 1 0.5875618 1
SURF 0
  TYPE STANDARD
  CURV 0.0
  DISZ INFINITY
SURF 1
  STOP
  TYPE %s
  CURV {1 / 25!r}
  CONI {CONIC}
%s
  DISZ {THICKNESS}
  GLAS ___BLANK 1 0 {INDEX} 0 0
  DIAM 5.5 1
  CLAP 0 5.5 0
SURF 2
  TYPE STANDARD
  CURV 0.0
  DISZ {BEHIND}
  DIAM 8 1
  CLAP 0 8 0
SURF 3
  TYPE STANDARD
  CURV 0.0
  DISZ 0
"""

Sag = Callable[[mp.mpf, mp.mpf], mp.mpf]


def conic(r2: mp.mpf, conic_constant: mp.mpf) -> mp.mpf:
    c = 1 / mp.mpf(RADIUS)
    return c * r2 / (1 + mp.sqrt(1 - (1 + conic_constant) * c * c * r2))


def extended_odd(x: mp.mpf, y: mp.mpf) -> mp.mpf:
    """OpticStudio's extended odd asphere: terms in powers of ρ = r over the norm radius, from ρ."""
    r = mp.sqrt(x * x + y * y)
    rho = r / mp.mpf(NORM)
    terms = (0, 0, mp.mpf("0.01"), mp.mpf("-0.02"), mp.mpf("0.005"))
    return conic(r * r, mp.mpf(CONIC)) + sum(a * rho ** (k + 1) for k, a in enumerate(terms))


def strong(x: mp.mpf, y: mp.mpf) -> mp.mpf:
    """Forbes 2007, eq. 2.6 and 2.7: conic + u⁴ Σ a Q(u²), Q Jacobi's P(0, 4) of 2 u² − 1."""
    r2 = x * x + y * y
    u2 = r2 / mp.mpf(NORM) ** 2
    terms = (mp.mpf("0.03"), mp.mpf("-0.01"), mp.mpf("0.004"))
    return conic(r2, mp.mpf(CONIC)) + u2**2 * sum(a * mp.jacobi(m, 0, 4, 2 * u2 - 1) for m, a in enumerate(terms))


def mild(x: mp.mpf, y: mp.mpf) -> mp.mpf:
    """Forbes 2007, eq. 3.10 to 3.12, with his first polynomials: a deviation u² (1 − u²) Σ a Q(u²) along the normal."""
    r2 = x * x + y * y
    u2 = r2 / mp.mpf(NORM) ** 2
    polynomials = (
        mp.mpf(1),
        (13 - 16 * u2) / mp.sqrt(19),
        mp.sqrt(mp.mpf(2) / 95) * (29 - 4 * u2 * (25 - 19 * u2)),
    )
    terms = (mp.mpf("0.02"), mp.mpf("-0.008"), mp.mpf("0.003"))
    deviation = u2 * (1 - u2) * sum(a * q for a, q in zip(terms, polynomials, strict=True))
    k, c2r2 = mp.mpf(CONIC), r2 / mp.mpf(RADIUS) ** 2
    # One over the cosine of the conic's slope.
    return conic(r2, k) + deviation * mp.sqrt((1 - k * c2r2) / (1 - (1 + k) * c2r2))


def toroid(x: mp.mpf, y: mp.mpf) -> mp.mpf:
    """OpticStudio's toroid: the curve in y–z turned about a line parallel to y, 40 mm before the vertex."""
    about = mp.mpf(40)
    curve = conic(y * y, mp.mpf(CONIC)) + mp.mpf("1e-5") * y**4
    return about - mp.sqrt((about - curve) ** 2 - x * x)


SURFACES: dict[str, tuple[str, str, Sag, float]] = {
    "XOSPHERE": ("XOSPHERE", "XDAT 1 5; XDAT 2 6; XDAT 5 0.01; XDAT 6 -0.02; XDAT 7 0.005", extended_odd, EXACT_MM),
    "strong": ("QED_TYPE", "XDAT 1 1; XDAT 2 3; XDAT 3 6; XDAT 4 0.03; XDAT 5 -0.01; XDAT 6 0.004", strong, EXACT_MM),
    "mild": ("QED_TYPE", "XDAT 1 0; XDAT 2 3; XDAT 3 6; XDAT 4 0.02; XDAT 5 -0.008; XDAT 6 0.003", mild, MILD_MM),
    "toroid": ("TOROIDAL", "PARM 1 40; PARM 3 1e-5", toroid, EXACT_MM),
}


def refracted(d: mp.matrix, normal: mp.matrix, ratio: mp.mpf) -> mp.matrix:
    """Snell's law for unit vectors; `ratio` is that of the indices, before over behind."""
    normal = normal / mp.norm(normal)
    cosine = (d.T * normal)[0]
    normal, cosine = (normal, cosine) if cosine > 0 else (-normal, -cosine)
    return ratio * d + (mp.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine) * normal


def landed(sag: Sag, p: np.ndarray, d: np.ndarray) -> list[mp.mpf]:
    """Return where a ray meets the image plane, by the surface's formula."""
    p, d = mp.matrix([mp.mpf(v) for v in p]), mp.matrix([mp.mpf(v) for v in d])
    t = mp.findroot(lambda t: p[2] + t * d[2] - sag(p[0] + t * d[0], p[1] + t * d[1]), -p[2] / d[2])
    p = p + t * d
    slopes = [mp.diff(sag, (p[0], p[1]), order) for order in ((1, 0), (0, 1))]
    index = mp.mpf(float(INDEX))
    d = refracted(d, mp.matrix([-slopes[0], -slopes[1], 1]), 1 / index)
    p = p + (mp.mpf(THICKNESS) - p[2]) / d[2] * d
    d = refracted(d, mp.matrix([0, 0, 1]), index)
    p = p + mp.mpf(BEHIND) / d[2] * d
    return [p[0], p[1]]


@pytest.mark.parametrize("name", SURFACES)
def test_real_rays_are_those_of_the_formula(name: str, tmp_path: Path) -> None:
    kind, lines, sag, most = SURFACES[name]
    path = tmp_path / "lens.zmx"
    path.write_text(FILE % (kind, "\n".join(f"  {line}" for line in lines.split("; "))))
    lens, _ = read_lens_file(path)
    sensor = {"pixels": [4000, 4000], "pixel_mm": 0.02, "distance_mm": float(BEHIND)}
    scene = lf.Scene(camera={"lens": lens, "focus_mm": 5000.0, "sensor": sensor})
    draw = np.random.default_rng(3)
    points = np.column_stack([draw.uniform(-2.5, 2.5, (10, 2)), np.full(10, -2.0)])
    directions = np.column_stack([draw.uniform(-0.1, 0.1, (10, 2)), np.ones(10)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    paths = lf.trace(lf.build(scene, aimed=False), points, directions, split="transmit", engine="sequential")
    assert paths.source.tolist() == list(range(10))
    with mp.workdps(40):
        truth = [[float(v) for v in landed(sag, p, d)] for p, d in zip(points, directions, strict=True)]
    np.testing.assert_allclose(paths.position[:, :2], truth, rtol=0.0, atol=most)
