"""Choice of the engine for a scene, with the reason.

The adjoint method needs the mesh engine only for reflections. With "both", the sequential engine traces the image path,
with nearly all light, and the mesh engine adds the other paths.
"""

from lfmesh.errors import SceneError
from lfmesh.scene import Scene
from lfmesh.transport.tables.interfaces import refused_in_order
from lfmesh.transport.tables.phase_faces import refuse_diffracting_phases


def engine_of(scene: Scene) -> tuple[str, str]:
    """Return the engine, "mesh", "sequential" or "both", and the reason in words.

    Raises
    ------
    SceneError
        The scene asks for the sequential engine, which cannot trace it, or for diffraction at lenslets with a phase.
    """
    transport = scene.transport
    refuse_diffracting_phases(scene)
    obstacle = obstacle_of(scene, transport.surface, transport.max_events)
    if transport.diffraction == "stop" and obstacle is not None:
        raise SceneError(f'transport.diffraction = "stop" needs sequential tracing of exact surfaces: {obstacle}')
    if transport.engine == "mesh":
        return "mesh", "as the scene asks; every lens surface, lenslet and target is a mesh in Embree"
    if transport.engine == "sequential":
        if obstacle is not None:
            raise SceneError(f'transport.engine = "sequential": {obstacle}; use "mesh" or "auto"')
        lost = "" if transport.split == "transmit" else "; reflections are left out"
        return "sequential", f"as the scene asks; sequential, through exact surfaces{lost}"
    if obstacle is not None:
        return "mesh", f"{obstacle}"
    if transport.split != "transmit":
        if transport.method == "forward":
            return "mesh", f'split = "{transport.split}" follows reflections'
        return "both", "the image path sequentially through exact surfaces; other paths packet by packet"
    return "sequential", "the scene asks for the image path only; sequential, through exact surfaces"


def obstacle_of(scene: Scene, surface: str, max_events: int, *, tracing: bool = False) -> str | None:
    """Return the reason, in words, why the sequential engine cannot trace a scene; None if it can.

    Parameters
    ----------
    scene : Scene
    surface : str
        Surface level, as in `transport.surface`.
    max_events : int
    tracing : bool
        For given rays.
    """
    if scene.transport.polarisation:
        return "transport.polarisation needs the mesh engine"
    if scene.transport.diffraction != "none" and tracing:
        return "transport.diffraction deflects light packet by packet"
    if scene.media and tracing:
        return "media are followed packet by packet"
    if surface != "exact":
        return f'surface = "{surface}" needs a mesh'
    if scene.camera.sensor.cover is not None and tracing:
        return "light is followed through the sensor's cover packet by packet"
    lens = scene.camera.lens
    for i, element in enumerate(lens.surfaces):
        if element.mesh is not None:
            return f"camera.lens.surfaces[{i}] is a mesh"
    refused = refused_in_order(scene)
    if refused is not None:
        return refused
    interfaces = len(lens.surfaces) + (0 if scene.camera.mla is None else 2)
    if scene.camera.sensor.cover is not None:
        interfaces += 2
    if interfaces >= max_events:
        return f"max_events = {max_events} cuts paths inside the lens"
    return None
