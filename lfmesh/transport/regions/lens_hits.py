"""The first surface of the lens that a packet meets: by its facet, by analytic roots, or by steps, in float64.

All in the camera frame.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.geometry.meshes.levels import EXACT, PATCH
from lfmesh.geometry.meshes.patch_tree import patch_finder
from lfmesh.geometry.ray import Ray, ray_of
from lfmesh.geometry.surfaces.surface import conic_distance, distance_to, first_crossing, normal_at
from lfmesh.geometry.surfaces.tessellation import OVERREACH
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.facets import crosses, facet_normal, meets_patch
from lfmesh.transport.packets.packet import NO_SURFACE, Flow
from lfmesh.transport.tables.tables import LensTables

Array = NDArray[np.float64]


RING = -2
"""Stands in for a surface number: the ring that bounds a space sideways."""


SAME_HIT = 1e-9
"""Relative distance between two hits on a surface below which they are the same hit, found in two ways."""


@inlined
def meets_at_facet(
    flow: Flow, lens: LensTables, packet: Any, prim: int, least: float
) -> tuple[int, float, float, float, float, float, float, float]:
    """Return the surface that a packet meets at a facet, the distance, the point, and the normal.

    The normal points along the ray. `RING` is the ring of the space. `NO_SURFACE` refuses the facet: it belongs to
    another space, is crossed in the wrong sense or, if flat and on the surface that the packet left, lies nearer than
    `least`. The other surface of the space may touch that one: its facets may lie behind the start by float32 rounding.

    Parameters
    ----------
    flow : Flow
    lens : LensTables
    packet : PACKET
    prim : int
        Number of the facet.
    least : float, mm
    """
    x, y, z = packet.x, packet.y, packet.z
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    space = packet.space
    facet = lens.facets[prim]
    normal = facet.normal
    nx, ny, nz = normal[0], normal[1], normal[2]
    along = nx * dx + ny * dy + nz * dz
    k = facet.body
    # A packet in front of a surface crosses its facets along their normals, a packet behind it against them.
    forward = k == space
    met = (forward and along > 0.0) or (k == space - 1 and along < 0.0)
    if met and is_conic(lens.surfaces[k]):
        # The sense alone decides between the two roots, so the facet's distance, a division, is not needed.
        t = packet.query_from
    else:
        t = (facet.offset - nx * x - ny * y - nz * z) / along if along != 0.0 else packet.query_from
    px, py, pz = x + t * dx, y + t * dy, z + t * dz
    if k < 0:
        met = -1 - k == space and t > 0.0
        k = RING
    elif met:
        surface = lens.surfaces[k]
        level = surface.level
        if level == EXACT:
            ex, ey, ez = dx, dy, dz
            if surface.posed:
                px, py, pz = point_through(surface.unpose, px, py, pz)
                ex, ey, ez = direction_through(surface.unpose, dx, dy, dz)
            pz -= surface.vertex_z
            met, more = distance_to(surface, Ray(px, py, pz, ex, ey, ez), 1.0 if forward else -1.0)
            t += more
            px, py, pz = px + more * ex, py + more * ey, pz + more * ez
            nx, ny, nz = normal_at(surface, px, py, pz)
            pz += surface.vertex_z
            if surface.posed:
                px, py, pz = point_through(surface.pose, px, py, pz)
                nx, ny, nz = direction_through(surface.pose, nx, ny, nz)
            if not met:
                t = (facet.offset - normal[0] * x - normal[1] * y - normal[2] * z) / along
            met = met and t > 0.0 and (nx * dx + ny * dy + nz * dz > 0.0) == forward
        else:
            again = k == packet.last
            met = t > (least if again else -packet.limit)
            if level == PATCH:
                curved, more, nx, ny, nz = meets_patch(
                    flow, lens.patches, lens.across, facet, prim, Ray(px, py, pz, dx, dy, dz)
                )
                t += more
                px, py, pz = px + more * dx, py + more * dy, pz + more * dz
                met = t > (0.0 if again else -packet.limit) if curved else met
            elif met:
                nx, ny, nz = facet_normal(level, facet, px, py, pz)
            if (nx * dx + ny * dy + nz * dz > 0.0) != forward:
                # An interpolated normal may point against a grazing ray; the facet's normal then replaces it.
                nx, ny, nz = normal[0], normal[1], normal[2]
        if not forward:
            nx, ny, nz = -nx, -ny, -nz
    return k if met else NO_SURFACE, t, px, py, pz, nx, ny, nz


@kernel
def first_conic(lens: LensTables, packet: Any) -> tuple[int, float, float, float, float, float, float, float, bool]:
    """Return the first conic of its space that a packet meets, the distance, the point, and the normal along the ray.

    Uses the analytic roots, without meshes. The last value tells whether all surfaces of the space are conics.

    A packet is in front of both surfaces of its space. If they touch, its start on one may lie on the other or, by
    rounding, beyond it; it then crosses the other at once, at its start or a root behind it.
    """
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    space = packet.space
    first, nearest = NO_SURFACE, np.inf
    fx, fy, fz, nx, ny, nz = 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    settled = True
    # Measured from the entry into the box: the start may be far away and would cost digits.
    ahead = packet.limit if packet.last == NO_SURFACE else 0.0
    x, y, z = packet.x + ahead * dx, packet.y + ahead * dy, packet.z + ahead * dz
    for k in range(max(space - 1, 0), min(space + 1, len(lens.surfaces))):
        surface = lens.surfaces[k]
        if not is_conic(surface):
            settled = False
            continue
        sense = 1.0 if k == space else -1.0
        sx, sy, sz, ex, ey, ez = x, y, z, dx, dy, dz
        if surface.posed:
            sx, sy, sz = point_through(surface.unpose, x, y, z)
            ex, ey, ez = direction_through(surface.unpose, dx, dy, dz)
        begin = Ray(sx, sy, sz - surface.vertex_z, ex, ey, ez)
        met, t = conic_distance(surface.curvature, surface.conic, begin, sense)
        px, py, pz = sx + t * ex, sy + t * ey, sz + t * ez - surface.vertex_z
        t += ahead
        on_sheet = surface.curvature * (1.0 + surface.conic) * pz < 1.0
        # A ray that leaves a conic meets it again only on the concave side; on the other, a root is rounding.
        again = k != packet.last or sense * surface.curvature < 0.0
        meets = met and again and on_sheet and t < nearest and _on_mesh(surface, px * px + py * py)
        if meets and (t > 0.0 or (k != packet.last and _crosses_at_once(surface, begin, sense))):
            first, nearest, fx, fy, fz = k, t, px, py, pz + surface.vertex_z
            mx, my, mz = normal_at(surface, px, py, pz)
            nx, ny, nz = sense * mx, sense * my, sense * mz
            if surface.posed:
                fx, fy, fz = point_through(surface.pose, fx, fy, fz)
                nx, ny, nz = direction_through(surface.pose, nx, ny, nz)
    return first, nearest, fx, fy, fz, nx, ny, nz, settled


@inlined
def _crosses_at_once(surface: Any, begin: Ray, sense: float) -> bool:
    """Tell whether a packet that starts on or beyond a conic crosses it at once.

    Neighbouring surfaces do not cross within both apertures, so a start there is beyond the conic by rounding alone.

    Parameters
    ----------
    surface : SURFACE record
    begin : Ray
        Relative to the vertex.
    sense : float
        Sense of the crossing.
    """
    x, y, z, dx, dy, dz = begin
    along = dz - surface.curvature * (x * dx + y * dy + (1.0 + surface.conic) * z * dz)
    return sense * along > 0.0 and _on_mesh(surface, x * x + y * y)


@kernel
def first_bulge(
    lens: LensTables, packet: Any, found: int, until: float
) -> tuple[int, int, float, float, float, float, float, float, float]:  # fmt: skip
    """Return the results of `first_conic` for other curved surfaces of a packet's space, which meshes may miss.

    After the surface comes the facet of its patch, −1 for an exact one.

    The vertices of a mesh are on the surface, so a ray that grazes a bulge may pass between surface and mesh, and a ray
    that leaves a concave surface may meet it again before the mesh. If surfaces touch, a query may begin behind the
    mesh of either. The steps used here miss no crossing.

    Parameters
    ----------
    found : int
        Surface found so far by its mesh or its roots.
    until : float, mm
        Distance of that hit; later ones are ignored.
    """
    space = packet.space
    first, nearest = NO_SURFACE, until
    fx, fy, fz, nx, ny, nz = 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    ahead = packet.limit if packet.last == NO_SURFACE else 0.0
    for k in range(max(space - 1, 0), min(space + 1, len(lens.surfaces))):
        surface = lens.surfaces[k]
        sense = 1.0 if k == space else -1.0
        if surface.level != EXACT or surface.terms == 0:
            continue
        if k == packet.last:
            if bulges_everywhere(surface, sense):
                continue
        elif k == found and _meets_once(surface):
            continue
        x, y, z, dx, dy, dz = packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz
        if surface.posed:
            x, y, z = point_through(surface.unpose, x, y, z)
            dx, dy, dz = direction_through(surface.unpose, dx, dy, dz)
        z -= surface.vertex_z
        in_front = k == packet.last or (ahead == 0.0 and x * x + y * y <= surface.domain * surface.domain)
        met, t = first_crossing(surface, Ray(x, y, z, dx, dy, dz), sense, ahead, nearest, in_front)
        if not met or (k == found and t > nearest * (1.0 - SAME_HIT)):
            continue
        first, nearest, fx, fy, fz = k, t, x + t * dx, y + t * dy, z + t * dz
        nx, ny, nz = normal_at(surface, fx, fy, fz)
        nx, ny, nz, fz = sense * nx, sense * ny, sense * nz, fz + surface.vertex_z
        if surface.posed:
            fx, fy, fz = point_through(surface.pose, fx, fy, fz)
            nx, ny, nz = direction_through(surface.pose, nx, ny, nz)
    # Ignore a crossing that the mesh has found already.
    prim, t, mx, my, mz = _first_patch(lens.tree, space, ray_of(packet), ahead, nearest * (1.0 - SAME_HIT))
    if prim >= 0:
        first, nearest = lens.facets[prim].body, t
        fx, fy, fz = packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz
        sense = 1.0 if first == space else -1.0
        nx, ny, nz = sense * mx, sense * my, sense * mz
    return first, prim, nearest, fx, fy, fz, nx, ny, nz


@inlined
def _sense_at(space: int, body: int) -> float:
    """Return the sense in which a packet in a space crosses the patches of a surface; 0 for surfaces elsewhere."""
    return 1.0 if body == space else (-1.0 if body == space - 1 else 0.0)


_first_patch = patch_finder(_sense_at)


@inlined
def bulges_everywhere(surface: Any, sense: float) -> bool:
    """Tell whether a surface, crossed in a sense, bulges everywhere into the space in front of it."""
    return surface.least_bend >= 0.0 if sense > 0.0 else surface.most_bend <= 0.0


@inlined
def _meets_once(surface: Any) -> bool:
    """Tell whether a line crosses a surface at most once in either sense: it is convex or concave everywhere."""
    return surface.least_bend >= 0.0 or surface.most_bend <= 0.0


@kernel
def crosses_beside(lens: LensTables, packet: Any) -> bool:
    """Tell whether a packet outside the lens crosses the outermost conic, even beside its mesh."""
    k = 0 if packet.space == 0 else len(lens.surfaces) - 1
    surface, sense = lens.surfaces[k], 1.0 if packet.space == 0 else -1.0
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    ahead = packet.limit if packet.last == NO_SURFACE else 0.0
    x, y, z = packet.x + ahead * dx, packet.y + ahead * dy, packet.z + ahead * dz - surface.vertex_z
    meets, t = conic_distance(surface.curvature, surface.conic, Ray(x, y, z, dx, dy, dz), sense)
    return meets and ahead + t > 0.0 and surface.curvature * (1.0 + surface.conic) * (z + t * dz) < 1.0


@kernel
def first_of_all(
    flow: Flow, lens: LensTables, packet: Any
) -> tuple[int, int, float, float, float, float, float, float, float]:
    """Return the first surface that a packet meets, its facet (−1: none), and the rest of `meets_at_facet`.

    Slow but certain: conics by their analytic roots and other exact surfaces by steps, because a ray along a concave
    one may run between surface and mesh; everything else by testing all facets in float64.

    Parameters
    ----------
    flow : Flow
    lens : LensTables
    packet : PACKET
    """
    x, y, z = packet.x, packet.y, packet.z
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    space = packet.space
    first_prim = -1
    first, nearest, fx, fy, fz, nx, ny, nz, settled = first_conic(lens, packet)
    if settled and (space == 0 or space == len(lens.surfaces)):
        # Outside the lens there is no ring.
        return first, first_prim, nearest, fx, fy, fz, nx, ny, nz
    k, facet, t, px, py, pz, mx, my, mz = first_bulge(lens, packet, first, nearest)
    if k != NO_SURFACE:
        first, first_prim, nearest, fx, fy, fz, nx, ny, nz = k, facet, t, px, py, pz, mx, my, mz
    if nearest <= 0.0:
        # It starts on a surface that it crosses at once.
        return first, first_prim, nearest, fx, fy, fz, nx, ny, nz
    for prim in range(len(lens.facets)):
        body = lens.facets[prim].body
        if body != space and body != space - 1 and body != -1 - space:
            continue
        t, _ = crosses(lens.facets[prim], x, y, z, dx, dy, dz)
        if not -packet.limit < t < np.inf:
            continue
        k, t, px, py, pz, mx, my, mz = meets_at_facet(flow, lens, packet, prim, -packet.limit)
        if k == NO_SURFACE or t >= nearest:
            continue
        if k >= 0 and is_conic(lens.surfaces[k]):
            surface = lens.surfaces[k]
            if _on_mesh(surface, radius2_at(surface, px, py, pz)):
                continue
        first, first_prim, nearest, fx, fy, fz, nx, ny, nz = k, prim, t, px, py, pz, mx, my, mz
    if first == NO_SURFACE and _is_between_exact(lens, space):
        # Neither surface is met, so it is the ring, between the circle of a rim and the chords of its mesh.
        first, nearest = RING, packet.limit
    return first, first_prim, nearest, fx, fy, fz, nx, ny, nz


@inlined
def _is_between_exact(lens: LensTables, space: int) -> bool:
    """Tell whether a space lies inside the lens, between two exact surfaces."""
    inside = 0 < space < len(lens.surfaces)
    return inside and lens.surfaces[space - 1].level == EXACT and lens.surfaces[space].level == EXACT


@inlined
def is_conic(surface: Any) -> bool:
    """Tell whether a surface is an exact conic, with hits in closed form."""
    return surface.level == EXACT and surface.terms == 0


@inlined
def radius2_at(surface: Any, x: float, y: float, z: float) -> float:
    """Return the squared distance of a point (camera frame) from the axis of a surface.

    Parameters
    ----------
    surface : SURFACE record
    x, y, z : float, mm
    """
    if surface.posed:
        x, y, z = point_through(surface.unpose, x, y, z)
    return x * x + y * y


@inlined
def _on_mesh(surface: Any, radius2: float) -> bool:
    """Tell whether a squared radius lies within the clear aperture plus the mesh's margin."""
    reach = _reach(surface)
    return radius2 <= reach * reach


@inlined
def _reach(surface: Any) -> float:
    """Return the radius, mm, of the largest circle that the mesh of a surface covers."""
    return min(surface.semi_diameter * (1.0 + OVERREACH), surface.end)
