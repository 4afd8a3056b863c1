"""Groups of replicates: independent, with random numbers shared within a group.

Samples of a pixel at even spacing over a band have far less colour noise than random ones. If each replicate spaced its
own samples, more replicates of fewer samples would have more noise. Replicates of a scene with bands therefore form up
to `GROUPS` groups. A group shares out the samples of a single replicate of its size: one set of Sobol' points and
wavelengths per pixel. Its replicates are dependent, so only the spread of the groups measures the error.

Replicates belong to the groups in turn, so the first few of an interrupted render are in different groups.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from lfmesh.scene import Scene
from lfmesh.transport.sources.wavelengths import Turn

GROUPS = 8
"""Largest number of groups of a scene with bands: the default number of replicates."""


@dataclass(frozen=True)
class Groups:
    """Groups of a scene's replicates.

    Attributes
    ----------
    replicates : int
        Replicates of a stage.
    count : int
        Number of groups: at most the number of replicates; each is then a group.
    """

    replicates: int
    count: int

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Return the groups of a scene; without bands, each replicate is one."""
        replicates = scene.transport.replicates
        return cls(replicates, replicates if scene.camera.sensor.bands is None else min(replicates, GROUPS))

    @classmethod
    def single(cls, scene: Scene) -> Self:
        """Return the replicates of a scene as independent groups of one."""
        return cls(scene.transport.replicates, scene.transport.replicates)

    @property
    def joined(self) -> bool:
        """True if there are groups of several replicates."""
        return self.count < self.replicates

    def begun(self, finished: int) -> int:
        """Return the number of groups begun by the first `finished` replicates of a stage."""
        return min(finished, self.count)

    def place(self, replicate: int) -> tuple[int, Turn]:
        """Return the first replicate of a replicate's group, which gives the group's key, and its turn.

        Successive replicates of a group take samples far apart, in van der Corput order.

        Parameters
        ----------
        replicate : int
            Numbered consecutively over both stages.
        """
        stage, number = divmod(replicate, self.replicates)
        member, group = divmod(number, self.count)
        members = len(range(group, self.replicates, self.count))
        order = np.argsort(np.argsort([_radical_inverse(k) for k in range(members)]))
        return stage * self.replicates + group, Turn(int(order[member]), members)


def _radical_inverse(number: int) -> float:
    """Return van der Corput's radical inverse in base 2: binary digits mirrored at the point."""
    return int(f"{number:b}"[::-1], 2) / (1 << number.bit_length()) if number else 0.0
