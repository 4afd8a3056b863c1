"""Compensators: numbers of a camera that assembly adjusts before the camera is judged."""

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene import Scene
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import Number, Text
from lfmesh.study.sweeps.axes import titled
from lfmesh.study.sweeps.paths import value_at

Merit = Callable[[Scene, str], float]
"""Function that rates a camera by a column of the table; larger is worse."""

FIRST_STEP = 0.5
LAST_STEP = 1e-3
"""First and last step of the search, over half an adjustment's range; the last is its resolution."""

WORST = 1e300
"""Substitute for an unknown merit: a barrier that turns the search back."""


class Compensator(Model):
    """A number of the camera that is adjusted at every point before the metrics are taken."""

    path: Text
    """The field, such as "camera.mla.pose.tilt_deg[2]"."""
    range: tuple[Number, Number]
    """Least and largest change by the adjustment; 0 lies between them."""
    metric: Text
    """Column of the table that it brings to its best, such as "centres_rms_px". Neighbours with the same one are
    adjusted together, others in their order."""
    label: Text | None = None
    """Name of the compensator in reports."""

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of the range."""
        low, high = self.range
        if not low <= 0.0 <= high or low == high:
            yield Fault(("range",), [low, high], "must include 0, and must not be empty")

    @property
    def title(self) -> str:
        """Name of the compensator in reports, with its unit."""
        return titled(self.path, self.label)

    def applied(self, scene: Scene, change: float) -> Scene:
        """Return a scene with the number changed by an amount.

        Raises
        ------
        SceneError
            The scene is not valid.
        """
        return scene.changed({self.path: value_at(scene, self.path) + change})


def compensated(scene: Scene, compensators: Sequence[Compensator], merit: Merit) -> tuple[Scene, list[float]]:
    """Adjust a camera, and return it with the change of each compensator.

    The search is COBYQA (Ragonneau and Zhang 2024): quadratic models within bounds, without derivatives.

    Parameters
    ----------
    scene : Scene
    compensators : sequence of Compensator
    merit : callable

    Raises
    ------
    SceneError
        A camera tried is not valid.
    """
    from scipy.optimize import minimize

    changes: list[float] = []
    for column, together in groupby(compensators, key=lambda each: each.metric):
        group, before = list(together), scene
        half = np.array([0.5 * (high - low) for low, high in (each.range for each in group)])

        def moved(at: NDArray[np.float64], group: list[Compensator] = group, before: Scene = before) -> Scene:
            for each, change in zip(group, at, strict=True):
                before = each.applied(before, float(np.clip(change, *each.range)))
            return before

        # A camera may have no merit, for example if no edge is visible.
        found = minimize(
            lambda at, half=half, moved=moved, column=column: np.nan_to_num(
                merit(moved(at * half), column), nan=WORST, posinf=WORST
            ),
            np.zeros(len(group)),
            method="COBYQA",
            bounds=[
                (low / size, high / size) for (low, high), size in zip((e.range for e in group), half, strict=True)
            ],
            options={"initial_tr_radius": FIRST_STEP, "final_tr_radius": LAST_STEP},
        )
        best = np.clip(found.x * half, *np.transpose([each.range for each in group]))
        scene = moved(best)
        changes += best.tolist()
    return scene, changes
