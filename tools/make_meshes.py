"""Make the meshes of the example scenes, in assets/meshes: a CAD-like part, and what an aquarium consists of.

The part, bracket.stl, is a rounded L-bracket with a rib, built with manifold3d. All are deterministic: run it again and
the files do not change. Lengths in mm. Needs the `dev` extra.
"""

from pathlib import Path

import manifold3d as m3
import numpy as np
import trimesh

ASSETS = Path(__file__).resolve().parent.parent / "assets"

WIDTH_MM = 34.0
BASE_MM = 36.0
HEIGHT_MM = 46.0
WALL_MM = 5.5
BEND_RADIUS_MM = 6.0
"""Inside the bend; outside it is this plus the wall."""
PLATE_CORNER_MM = 7.0
EDGE_RADIUS_MM = 1.0
"""Every outer edge is rounded by this much."""
FINEST_MM = 0.02
"""Triangles smaller than this deviation are simplified away."""


def profile() -> m3.CrossSection:
    """Return the bent sheet seen along its width: x runs along the base, y up the upright."""
    sheet = m3.CrossSection.square((BASE_MM, WALL_MM)) + m3.CrossSection.square((WALL_MM, HEIGHT_MM))
    # Growing and shrinking by the same radius fills the concave corner with a fillet of that radius.
    filleted = sheet.offset(BEND_RADIUS_MM, m3.JoinType.Round, circular_segments=64)
    filleted = filleted.offset(-BEND_RADIUS_MM, m3.JoinType.Round, circular_segments=64)
    outer_radius = BEND_RADIUS_MM + WALL_MM
    corner = m3.CrossSection.square((outer_radius, outer_radius))
    corner -= m3.CrossSection.circle(outer_radius, 96).translate((outer_radius, outer_radius))
    return filleted - corner


def plate(length: float) -> m3.CrossSection:
    """Return a leg seen face on, its free end with rounded corners; x across the width, y along the leg."""
    inset = PLATE_CORNER_MM
    core = m3.CrossSection.square((WIDTH_MM - 2 * inset, 2 * length - 2 * inset))
    core = core.translate((inset - WIDTH_MM / 2, inset - length))
    return core.offset(inset, m3.JoinType.Round, circular_segments=64)


def along_y(cross_section: m3.CrossSection, length: float) -> m3.Manifold:
    """Extrude and turn so that the section's (x, y) become (y, z) and the extrusion runs along +x."""
    return m3.Manifold.extrude(cross_section, length).rotate((90, 0, 90))


def bore(radius: float, depth: float, segments: int = 48) -> m3.Manifold:
    """Return a cylinder centred on the origin along z, to be subtracted."""
    return m3.Manifold.cylinder(depth, radius, radius, segments, center=True)


def countersunk(radius: float, head_radius: float) -> m3.Manifold:
    """Return the tool of a countersunk screw hole: z up, the upper face of the wall at z = 0."""
    head = m3.Manifold.cylinder(head_radius - radius, radius, head_radius, 48)
    return bore(radius, 4 * WALL_MM) + head.translate((0, 0, radius - head_radius + 0.01))


def rounded_edges(solid: m3.Manifold) -> m3.Manifold:
    """Round every convex edge: roll a ball over a solid that is undersized by the ball's radius."""
    return solid.minkowski_sum(m3.Manifold.sphere(EDGE_RADIUS_MM, 16))


def bracket() -> m3.Manifold:
    """Return the part: x along the base, y across the width (centred), z up the upright; mm."""
    r = EDGE_RADIUS_MM
    body = m3.Manifold.extrude(profile().offset(-r, m3.JoinType.Miter), WIDTH_MM - 2 * r)
    body = body.rotate((90, 0, 0)).translate((0, WIDTH_MM / 2 - r, 0))

    upright = along_y(plate(HEIGHT_MM).offset(-r, m3.JoinType.Round, circular_segments=64), 2 * BASE_MM)
    base = m3.Manifold.extrude(
        plate(BASE_MM).offset(-r, m3.JoinType.Round, circular_segments=64), 3 * HEIGHT_MM
    ).rotate((0, 0, -90))
    body = body ^ upright.translate((-BASE_MM / 2, 0, 0)) ^ base.translate((0, 0, -HEIGHT_MM))

    rib_profile = m3.CrossSection([[(r, r), (BASE_MM * 0.72, r), (r, HEIGHT_MM * 0.62)]])
    rib = m3.Manifold.extrude(rib_profile, 5.0 - 2 * r).rotate((90, 0, 0)).translate((0, 2.5 - r, 0))
    inside = m3.Manifold.cube((BASE_MM, WIDTH_MM, HEIGHT_MM)).translate((WALL_MM / 2, -WIDTH_MM / 2, WALL_MM / 2))
    solid = rounded_edges(body + (rib ^ inside))

    for y in (-9.5, 9.5):
        hole = countersunk(2.1, 4.0).translate((BASE_MM - 9.5, y, WALL_MM))
        solid -= hole
    eye = bore(6.5, 4 * WALL_MM, 72).rotate((0, 90, 0)).translate((0, 0, HEIGHT_MM - 12.0))
    solid -= eye
    for y in (-11.5, 11.5):
        slot = (bore(2.0, 4 * WALL_MM).translate((-3.5, 0, 0)) + bore(2.0, 4 * WALL_MM).translate((3.5, 0, 0))).hull()
        solid -= slot.rotate((0, 90, 0)).translate((0, y, HEIGHT_MM * 0.45))
    return solid.simplify(FINEST_MM)


def as_trimesh(solid: m3.Manifold) -> trimesh.Trimesh:
    """Return the solid as a trimesh, centred on the middle of its bounding box."""
    mesh = solid.to_mesh()
    part = trimesh.Trimesh(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts))
    part.apply_translation(-part.bounds.mean(axis=0))
    return part


TANK_MM = (130.0, 110.0)
"""Width and height of the aquarium's walls and of its water."""


def slab(thickness: float) -> trimesh.Trimesh:
    """Return a box as wide and high as the aquarium, centred."""
    return trimesh.creation.box((*TANK_MM, thickness))


def written(mesh: trimesh.Trimesh, name: str) -> None:
    """Write a closed, outward-oriented solid, and say what was written."""
    path = ASSETS / "meshes" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)
    found = trimesh.load_mesh(path)
    assert found.is_volume, f"{name} is not a closed, outward-oriented solid"
    size = " x ".join(f"{extent:.0f}" for extent in found.extents)
    print(f"{path.relative_to(ASSETS.parent)}: {len(found.faces)} triangles, {size} mm")


def main() -> None:
    written(as_trimesh(bracket()), "bracket.stl")
    written(slab(5.0), "window.stl")
    written(slab(70.0), "water.stl")
    # With the vertex normals of the sphere, which PLY keeps.
    ball = trimesh.creation.icosphere(3, 16.0)
    written(trimesh.Trimesh(ball.vertices, ball.faces, vertex_normals=ball.vertices / 16.0, process=False), "ball.ply")


if __name__ == "__main__":
    main()
