"""The glasses of a scene, each with the air it stands in."""

from typing import TYPE_CHECKING, Any

from lfmesh.scene.materials.own_glass import OwnGlass
from lfmesh.scene.media.air import Air

if TYPE_CHECKING:
    from lfmesh.scene.scene import Scene


def in_its_air(scene: "Scene") -> "Scene":
    """Return a scene whose `camera.air` is used up: every glass says itself in which air it stands.

    A scene without that key comes back as it is. Numbers in `index` stay, as does a glass that has an `air` of its own.
    """
    air = scene.camera.air
    if air is None:
        return scene
    camera = scene.camera
    surfaces = tuple(_placed(_placed(each, air), air, "refractor") for each in camera.lens.surfaces)
    lens = _placed(camera.lens.model_copy(update={"surfaces": surfaces}), air, "object_medium")
    mla = _placed(camera.mla, air)
    sensor = _placed(camera.sensor, air, "cover")
    tanks = tuple(_placed(_placed(tank, air, "wall"), air, "liquid") for tank in scene.tanks)
    return scene.model_copy(
        update={
            "camera": camera.model_copy(update={"air": None, "lens": lens, "mla": mla, "sensor": sensor}),
            "targets": tuple(_placed(target, air, "refractor") for target in scene.targets),
            "tanks": tanks,
        }
    )


def _placed(model: Any, air: Air, part: str | None = None) -> Any:
    """Return a model whose glass, or that of one of its parts, stands in some air."""
    if part is not None:
        return model.model_copy(update={part: _placed(getattr(model, part), air)})
    if model is None or model.glass is None:
        return model
    glass = OwnGlass(name=model.glass) if isinstance(model.glass, str) else model.glass
    return model if glass.air is not None else model.model_copy(update={"glass": glass.model_copy(update={"air": air})})
