"""Checks of public functions' arguments: wrong types are refused in one line."""

import inspect
import reprlib
from collections.abc import Callable
from functools import wraps
from numbers import Real
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from lfmesh.errors import LfmeshError

MADE_BY = {
    "Scene": 'lf.load("scene.toml") reads one',
    "World": "lf.build(scene) makes one",
    "Image": 'lf.render(scene) makes one, lf.open_run("run/") reads one',
    "LightField": "lf.decode(image) makes one",
    "Calibration": "lf.calibrate(scene) makes one",
    "LensAnalysis": "lf.analyse(scene) makes one",
    "CameraModel": "lf.camera_model(scene) makes one",
    "FocalStack": "lf.focal_stack(field) makes one",
}
"""Sources of each class, in the words of a message."""


def with_checked_arguments(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make a function refuse arguments other than the numbers and lfmesh classes in its annotations.

    Parameters annotated with anything else, such as arrays or paths, are not checked.
    """
    try:
        hints = get_type_hints(function)
    except NameError:
        # Annotations that only a type checker knows.
        return function
    signature = inspect.signature(function, follow_wrapped=False)
    kinds = {name: found for name in signature.parameters if (found := _classes(hints.get(name)))}
    if not kinds:
        return function

    @wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        given = dict(zip(signature.parameters, args, strict=False)) | kwargs
        for name, classes in kinds.items():
            if name in given and not isinstance(given[name], classes) and not _is_number(given[name], classes):
                raise LfmeshError(_refusal(function.__name__, name, given[name], classes))
        return function(*args, **kwargs)

    return checked


def _classes(annotation: Any) -> tuple[type, ...]:
    """Return the classes allowed by an annotation: lfmesh's or numbers', and None; empty if it has others."""
    classes = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    own = [each for each in classes if each is not type(None)]
    if own and all(each in (float, int) for each in own):
        # The function itself checks for whole numbers.
        return (Real, *(each for each in classes if each is not float))
    plain = all(isinstance(each, type) and each.__module__.startswith("lfmesh.") for each in own)
    return tuple(classes) if own and plain and not any(getattr(each, "_is_protocol", False) for each in own) else ()


def _is_number(value: Any, classes: tuple[type, ...]) -> bool:
    """Tell whether a value is an allowed number in a zero-dimensional array."""
    return Real in classes and getattr(value, "ndim", None) == 0 and isinstance(value.item(), Real)


def _refusal(function: str, name: str, value: Any, classes: tuple[type, ...]) -> str:
    if Real in classes:
        shown = f'"{value:.60}"' if isinstance(value, str) else reprlib.repr(value)
        return f"{name} = {shown}: must be a {'whole ' if int in classes else ''}number"
    names = [each.__name__ for each in classes if each is not type(None)]
    ways = [MADE_BY[each] for each in names if each in MADE_BY]
    given = repr(value) if isinstance(value, str) else f"of type {type(value).__name__}"
    how = f"; {', or '.join(ways)}" if ways else ""
    return f"lf.{function} needs {' or '.join(names)} for {name}, which is {given}{how}"
