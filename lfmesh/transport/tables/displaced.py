"""Refuse media that bodies of glass or liquid displace."""

from lfmesh.errors import SceneError
from lfmesh.geometry.meshes.crossings import parts_in_shells, set_back
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.transport.tables.hosts import Hosts


def refuse_displaced(boundary: Array, where: str, hosts: Hosts, body: int | None) -> None:
    """Refuse a medium in air that lies wholly in bodies, and a medium in a body that lies wholly outside it.

    Parameters
    ----------
    boundary : (m, 3, 3) float64, mm, world frame
        Corners of the outward facets of the medium's boundary.
    where : str
        Its name.
    hosts : Hosts
    body : int or None
        Body that holds the medium; None: around the bodies.

    Raises
    ------
    SceneError
        Naming the medium and the body.
    """
    if body is not None:
        touching = hosts.touching_mm(boundary, [body])
        its = hosts.corners[body]
        if not (_reaches_into(boundary, its, touching) or _reaches_into(its, boundary, touching)):
            name = hosts.names[body]
            raise SceneError(f'{where}: lies wholly outside {name}, though inside = "{name}": move it')
        return
    tops = hosts.top_along(boundary, just_inside=True)
    if None in tops or _holds_a_hollow(boundary, hosts):
        return
    name = hosts.names[tops[0] or 0]
    raise SceneError(
        f'{where}: lies inside {name}, which displaces its surroundings; give inside = "{name}", or move it'
    )


def _reaches_into(surface: Array, shell: Array, touching: float) -> bool:
    """Tell whether any place just behind a surface is in a shell."""
    return bool(parts_in_shells(set_back(surface, touching), [shell], touching)[0].any())


def _holds_a_hollow(boundary: Array, hosts: Hosts) -> bool:
    """Tell whether a body's face borders a place inside the boundary without bodies."""
    bodies = hosts.near(boundary)
    shells = [boundary, *(hosts.corners[body] for body in bodies)]
    touching = hosts.touching_mm(boundary, bodies)
    for body in bodies:
        inside, _ = parts_in_shells(set_back(hosts.corners[body], -touching), shells, touching)
        if (inside[:, 0] & ~inside[:, 1:].any(axis=1)).any():
            return True
    return False
