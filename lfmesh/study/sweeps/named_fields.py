"""Fields that a scene loses when it is solved, restored where a study varies them."""

from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from lfmesh.scene import Scene
from lfmesh.scene.changes import steps_of
from lfmesh.scene.materials.glass_in_air import out_of_its_air
from lfmesh.study.sweeps.paths import value_at

AIR = "camera.air"
"""Field that solving a scene gives to every glass."""

TANKS = "tanks"
"""Field that solving a scene replaces by targets."""

USED_UP = {
    "camera.mla.focal_length_mm": "camera.mla.radius_mm",
    "camera.lens.f_number": None,
    "camera.lens.epd_mm": None,
    "camera.lens.stop_semi_diameter_mm": None,
    "camera.object_medium": None,
    "camera.image_medium": None,
}
"""Fields that solving a scene replaces by others, and the optional field that then has the same meaning."""


def with_named(ready: Scene, given: Scene, paths: Iterable[str]) -> Scene:
    """Restore in a solved scene the given fields that a study varies: focal lengths, stop, media, air, tanks.

    Parameters
    ----------
    ready : Scene
    given : Scene
        The same, before it was solved.
    paths : iterable of str
        Paths that vary.
    """
    changes: dict[str, Any] = {}
    paths = tuple(paths)
    if any(steps_of(path)[:2] == steps_of(AIR) for path in paths):
        ready = out_of_its_air(ready)
    if any(steps_of(path)[0] == TANKS for path in paths) and given.tanks:
        # A solved scene has the bodies that they consist of among its targets.
        changes |= {TANKS: given.tanks, "targets": given.targets}
    for field, other in USED_UP.items():
        if any(steps_of(path)[: len(steps_of(field))] == steps_of(field) for path in paths):
            with suppress(KeyError):
                if (value := value_at(given, field)) is not None:
                    changes |= {field: value} | ({} if other is None else {other: None})
    return ready.changed(changes) if changes else ready
