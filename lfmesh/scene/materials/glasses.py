"""The glasses that a scene names, in words."""

from lfmesh.optics.glass import glass_in_words
from lfmesh.scene.materials.own_glass import OwnGlass
from lfmesh.scene.scene import Scene

Glass = str | OwnGlass


def glass_lines(scene: Scene) -> list[str]:
    """Describe each glass of a solved scene in a line: locations, name with catalogue, nd and Vd."""
    places: dict[Glass, list[str]] = {}
    outside = scene.camera.lens.object_medium
    if outside is not None and outside.glass is not None:
        places[outside.glass] = ["object medium"]
    last = scene.camera.lens.last_interface
    for i, surface in enumerate(scene.camera.lens.surfaces[: last + 1]):
        if surface.glass is not None:
            places.setdefault(surface.glass, []).append(f"surface {i}" if i < last else "image medium")
    if scene.camera.mla is not None and scene.camera.mla.glass is not None:
        places.setdefault(scene.camera.mla.glass, []).append("mla")
    if scene.camera.sensor.cover is not None and scene.camera.sensor.cover.glass is not None:
        places.setdefault(scene.camera.sensor.cover.glass, []).append("sensor's cover")
    for i, target in enumerate(scene.targets):
        if target.refractor is not None and target.refractor.glass is not None:
            # The bodies of a tank are named after it.
            name = target.name if target.refractor.solid is not None else None
            places.setdefault(target.refractor.glass, []).append(name or f"targets[{i}]")
    for name, coating in scene.all_coatings.items():
        for layer in coating.layers or ():
            if layer.glass is not None and f"coating {name}" not in places.get(layer.glass, []):
                places.setdefault(layer.glass, []).append(f"coating {name}")
    return [f"{'glass':<23}{glass_in_words(glass)}: {', '.join(where)}" for glass, where in places.items()]
