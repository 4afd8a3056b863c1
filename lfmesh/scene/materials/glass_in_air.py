"""The glasses of a scene, each with the air around it."""

from collections.abc import Callable
from typing import Any

from lfmesh.scene.materials.own_glass import in_air, out_of_air
from lfmesh.scene.scene import Scene


def in_its_air(scene: Scene) -> Scene:
    """Return a scene with `camera.air` given to every glass that has no `air` of its own.

    Plain numbers in `index` stay, and so does `camera.air`: the index of gases is relative to it.
    """
    return _with_glasses(scene, in_air)


def out_of_its_air(scene: Scene) -> Scene:
    """Return a scene before `in_its_air`, so that its glasses follow changes of `camera.air`.

    A glass with an `air` of its own that equals `camera.air` follows too.
    """
    return _with_glasses(scene, out_of_air)


def _with_glasses(scene: Scene, made: Callable[..., Any]) -> Scene:
    """Return a scene with a function of its air applied to every glass."""
    air = scene.camera.air
    if air is None:
        return scene
    camera = scene.camera
    surfaces = tuple(made(made(each, air), air, "refractor") for each in camera.lens.surfaces)
    lens = made(camera.lens.model_copy(update={"surfaces": surfaces}), air, "object_medium")
    mla = made(camera.mla, air)
    sensor = made(camera.sensor, air, "cover")
    tanks = tuple(made(made(tank, air, "wall"), air, "liquid") for tank in scene.tanks)
    return scene.model_copy(
        update={
            "camera": camera.model_copy(update={"lens": lens, "mla": mla, "sensor": sensor}),
            "targets": tuple(made(target, air, "refractor") for target in scene.targets),
            "tanks": tanks,
        }
    )
