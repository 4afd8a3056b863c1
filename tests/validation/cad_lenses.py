"""Lenses that a CAD kernel writes as STEP: gmsh (OpenCASCADE), a tool of tests alone, and the prescriptions they have.

`tests/solids` holds some of them for where gmsh is not there; `python tests/validation/cad_lenses.py` wrote those.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

SOLIDS = Path(__file__).resolve().parents[1] / "solids"


def sag(r, radius, conic=0.0, terms=()):
    """The standard form of ISO 10110-12, written out: conic and even terms of r⁴, r⁶, ..."""
    c = 1.0 / radius
    z = c * r * r / (1.0 + np.sqrt(1.0 - (1.0 + conic) * c * c * r * r))
    return z + sum(a * r ** (2 * j + 4) for j, a in enumerate(terms))


def begun(gmsh):
    gmsh.clear()
    return gmsh.model.occ


def written(gmsh, path, body, turn_deg=0.0, shift_z=0.0):
    """Write a body, turned about z and shifted along it."""
    occ = gmsh.model.occ
    occ.rotate(body, 0, 0, 0, 0, 0, 1, np.deg2rad(turn_deg))
    occ.translate(body, 0, 0, shift_z)
    occ.synchronize()
    gmsh.write(str(path))
    return path


def cylinder_lens(gmsh, path, radius, thickness, rim, square=False, **where):
    """A cylinder's surface in front, its axis along y before it is turned, and a plane behind; a rod or a box."""
    occ = begun(gmsh)
    low = -abs(radius)
    edge = (
        occ.addBox(-rim, -rim, low, 2 * rim, 2 * rim, thickness - low)
        if square
        else occ.addCylinder(0, 0, low, 0, 0, thickness - low, rim)
    )
    tool = [(3, occ.addCylinder(0, -3 * rim, radius, 0, 6 * rim, 0, abs(radius)))]
    cut = occ.intersect if radius > 0 else occ.cut
    body, _ = cut([(3, edge)], tool)
    return written(gmsh, path, body[:1], **where)


def toric_lens(gmsh, path, radius_y, radius_x, thickness, rim, **where):
    """A torus whose axis is along y before, radius_x > radius_y > 0, and a plane behind."""
    occ = begun(gmsh)
    body = [(3, occ.addCylinder(0, 0, -1.0, 0, 0, thickness + 1.0, rim))]
    ring = [(3, occ.addTorus(0, 0, 0, radius_x - radius_y, radius_y, zAxis=[0, 1, 0]))]
    occ.translate(ring, 0, 0, radius_x)
    body, _ = occ.intersect(body, ring)
    return written(gmsh, path, body, **where)


def turned_lens(gmsh, path, front, thickness, rim, **where):
    """A curve turned about z before, and a plane behind.

    `front` returns the tag of a curve from one point to another, which are the vertex and the rim.
    """
    occ = begun(gmsh)
    curve, vertex, edge = front(occ)
    corners = [occ.addPoint(rim, 0, thickness), occ.addPoint(0, 0, thickness)]
    outline = [edge, *corners, vertex]
    lines = [curve, *(occ.addLine(a, b) for a, b in pairwise(outline))]
    face = [(2, occ.addPlaneSurface([occ.addCurveLoop(lines)]))]
    body = [each for each in occ.revolve(face, 0, 0, 0, 0, 0, 1, 2 * np.pi) if each[0] == 3]
    occ.remove(face)
    occ.remove([(1, each) for each in lines])
    return written(gmsh, path, body, **where)


def ellipse(radius, conic, rim) -> Any:
    """The arc of an ellipse with a radius and a conic constant above -1 at its vertex, up to the rim."""

    def front(occ):
        along, across = radius / (1.0 + conic), abs(radius) / np.sqrt(1.0 + conic)
        vertex, middle = occ.addPoint(0, 0, 0), occ.addPoint(0, 0, along)
        edge = occ.addPoint(rim, 0, sag(rim, radius, conic))
        longer = vertex if abs(along) > across else occ.addPoint(across, 0, along)
        return occ.addEllipseArc(vertex, middle, longer, edge), vertex, edge

    return front


def spline(curve, rim, points=60) -> Any:
    """A cubic B-spline through points of a profile z(r)."""

    def front(occ):
        r = 0.5 * rim * (1.0 - np.cos(np.linspace(0.0, np.pi, points)))
        tags = [occ.addPoint(x, 0, z) for x, z in zip(r, curve(r), strict=True)]
        return occ.addSpline(tags), tags[0], tags[-1]

    return front


def rational_arc(radius, conic, rim) -> Any:
    """A conic as a rational B-spline of degree 2 with three points, as CAD kernels write arcs: exact for each conic."""

    def front(occ):
        low, high = np.zeros(2), np.array([rim, sag(rim, radius, conic)])
        # The tangents meet at the middle point; a point half-way sets its weight.
        c = 1.0 / radius
        slope = c * rim / np.sqrt(1.0 - (1.0 + conic) * c * c * rim * rim)
        middle = np.array([rim - high[1] / slope, 0.0])
        weight = _weight(radius, conic, low, middle, high)
        tags = [occ.addPoint(p[0], 0, p[1]) for p in (low, middle, high)]
        curve = occ.addBSpline(tags, degree=2, weights=[1.0, weight, 1.0], knots=[0.0, 1.0], multiplicities=[3, 3])
        return curve, tags[0], tags[-1]

    return front


def _weight(radius, conic, low, middle, high):
    """The weight by which the arc's point at half its parameter, on the line to `middle`, lies on the conic."""
    chord = 0.5 * (low + high)
    near, far = 0.0, 1.0
    for _ in range(200):
        share = 0.5 * (near + far)
        r, z = chord + share * (middle - chord)
        # Inside of the conic, towards its centre, 2 R z > r² + (1 + k) z².
        inside = np.sign(radius) * (2.0 * radius * z - (r * r + (1.0 + conic) * z * z)) > 0.0
        near, far = (share, far) if inside else (near, share)
    return share / (1.0 - share)


if __name__ == "__main__":
    import gmsh

    gmsh.initialize()
    cylinder_lens(gmsh, SOLIDS / "cylinder.step", 30.0, 5.0, 8.0, turn_deg=30.0)
    turned_lens(gmsh, SOLIDS / "asphere.step", spline(lambda r: sag(r, 25.0, -0.7, (1e-6, -2e-9)), 8.0), 6.0, 8.0)
    turned_lens(gmsh, SOLIDS / "rational.step", rational_arc(25.0, 0.0, 8.0), 6.0, 8.0)
    gmsh.finalize()
