"""Lights of a scene with motion: their movers, with a tree of lights for each mover."""

from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.scene import Scene
from lfmesh.transport.tables.emitting_facets import emitter_table
from lfmesh.transport.tables.forward_sources import sources_of
from lfmesh.transport.tables.lights import with_movers
from lfmesh.transport.tables.motions import Motions
from lfmesh.transport.tables.tables import NOTHING_NEAR_LAMPS, ObjectTables


def with_moving_lights(objects: ObjectTables, motions: Motions | None, scene: Scene, mesh: Mesh) -> ObjectTables:
    """Return tables whose lights know their movers; unchanged without motion.

    Light scattered near lamps is not sampled by itself then: scattered packets find all of it.

    Parameters
    ----------
    objects : ObjectTables
        With spheres that hold everything throughout the exposure.
    motions : Motions or None
    scene : Scene
    mesh : Mesh
        Mesh of targets and housing, object frame.
    """
    if motions is None:
        return objects
    if objects.volumes is not None:
        objects = objects._replace(volumes=objects.volumes._replace(near_lamps=NOTHING_NEAR_LAMPS))
    objects = objects._replace(
        lamps=with_movers(objects.lamps, motions.of_lamp), emitters=emitter_table(objects, motions.of_target)
    )
    return objects._replace(sources=sources_of(scene, objects, mesh, motions))
