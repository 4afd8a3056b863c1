"""Fields of a scene by path: values, and suggestions for paths that do not exist."""

from collections.abc import Mapping
from typing import Any

from lfmesh.scene import Scene
from lfmesh.scene.changes import steps_of
from lfmesh.scene.model import Model, dead_end, format_path, nearest


def value_at(scene: Scene, path: str) -> Any:
    """Return the value of a field, such as "camera.mla.pose.tilt_deg[0]".

    Raises
    ------
    KeyError
        No such field; the message says where the path ends, and what is valid there.
    """
    place: Any = scene
    done: list[str | int] = []
    for step in steps_of(path):
        where = format_path(done) or "the scene"
        if isinstance(place, Model):
            place = _field(place, step, where)
        elif isinstance(place, Mapping):
            if step not in place:
                raise KeyError(f"{where} has no {step!r}{nearest(str(step), map(str, place))}")
            place = place[step]
        elif place is None:
            raise KeyError(f"the scene has no {where}")
        else:
            reason = dead_end(place, step, done)
            if reason is not None:
                raise KeyError(reason)
            place = place[step]
        done.append(step)
    return place


def _field(model: Model, step: str | int, where: str) -> Any:
    fields = type(model).model_fields
    if not isinstance(step, str) or step not in fields:
        raise KeyError(f"{where} has no field {step!r}{nearest(str(step), fields)}; valid here: {', '.join(fields)}")
    return getattr(model, step)
