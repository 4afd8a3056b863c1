"""The glasses of a scene, each with the air around it."""

from lfmesh.scene.materials.own_glass import in_air
from lfmesh.scene.scene import Scene


def in_its_air(scene: Scene) -> Scene:
    """Return a scene with `camera.air` given to every glass that has no `air` of its own.

    Plain numbers in `index` stay, and so does `camera.air`: the index of gases is relative to it.
    """
    air = scene.camera.air
    if air is None:
        return scene
    camera = scene.camera
    surfaces = tuple(in_air(in_air(each, air), air, "refractor") for each in camera.lens.surfaces)
    lens = in_air(camera.lens.model_copy(update={"surfaces": surfaces}), air, "object_medium")
    mla = in_air(camera.mla, air)
    sensor = in_air(camera.sensor, air, "cover")
    tanks = tuple(in_air(in_air(tank, air, "wall"), air, "liquid") for tank in scene.tanks)
    return scene.model_copy(
        update={
            "camera": camera.model_copy(update={"lens": lens, "mla": mla, "sensor": sensor}),
            "targets": tuple(in_air(target, air, "refractor") for target in scene.targets),
            "tanks": tanks,
        }
    )
