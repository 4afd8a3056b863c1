"""Seeing what rays do: launching them, their paths in tables and pictures, the scene in 3D.

`lfmesh.view` is both this package and the function that shows a scene: `lf.view(scene)` is `lfmesh.view.show.view`.
"""

import sys
from types import ModuleType
from typing import Any


class _Showing(ModuleType):
    """A package that can be called: whichever of its modules is imported first, `lf.view` stays what it is."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        from lfmesh.view.show import view

        return view(*arguments, **options)


sys.modules[__name__].__class__ = _Showing
