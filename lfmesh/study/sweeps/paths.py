"""Fields of a scene by path: values, and suggestions for paths that do not exist."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any

from lfmesh.scene import Scene
from lfmesh.scene.changes import steps_of
from lfmesh.scene.model import Model, UnknownKey, dead_end, format_path, nearest
from lfmesh.study.sweeps.axes import is_number


def value_at(scene: Scene, path: str) -> Any:
    """Return the value of a field, such as "camera.mla.pose.tilt_deg[0]".

    Raises
    ------
    KeyError
        No such field; the message says where the path ends, and what is valid there.
    """
    place: Any = scene
    done: list[str | int] = []
    around: list[tuple[type[Model], int]] = []
    for step in steps_of(path):
        where = format_path(done) or "the scene"
        if isinstance(place, Model):
            around.append((type(place), len(done)))
            fields = type(place).model_fields
            if step not in fields:
                near, end = nearest(str(step), fields), _places(around, [*done, step])
                raise KeyError(f"{where} has no field {step!r}{near}{end}")
            place = getattr(place, str(step))
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


def number_path(path: str, values: Iterable[Any], scene: Scene) -> str:
    """Return the path to vary a field by: that of the only number, if the field is a list of one.

    Parameters
    ----------
    path : str
    values : iterable
        Listed values of the field; numbers, if it may vary as one.
    scene : Scene
    """
    with suppress(KeyError):
        found = value_at(scene, path)
        if isinstance(found, tuple) and len(found) == 1 and all(map(is_number, (*found, *values))):
            return f"{path}[0]"
    return path


def _places(around: list[tuple[type[Model], int]], path: list[str | int]) -> str:
    """Return the places where the last key of a path is valid.

    Parameters
    ----------
    around : list of (type of Model, int)
        Models on the path, with the number of steps to each.
    path : list of str or int
    """
    unknown = UnknownKey(str(path[-1]), tuple(around[-1][0].model_fields))
    for model, steps in reversed(around):
        unknown = unknown.sought_in(model, len(path) - steps)
    return unknown.in_words(tuple(path), None, "")
