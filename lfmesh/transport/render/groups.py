"""Groups of replicates: independent of each other, while the replicates of one group share a set of random numbers.

Samples of a pixel that lie evenly over a band have far less colour noise than random ones. If each replicate did that
for itself, more replicates of fewer samples would have more noise. So the replicates of a scene with bands form up to
`GROUPS` groups. A group takes the samples that a single replicate of its size would take: one set of Sobol' points and
of wavelengths for each pixel, of which each replicate traces some. Replicates of a group depend on each other, so that
their spread says little of the error; the spread of the groups does.

Replicates belong to the groups in turn, so that the first few of an interrupted render are of different groups.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from lfmesh.scene import Scene
from lfmesh.transport.sources.wavelengths import Turn

GROUPS = 8
"""Largest number of groups of a scene with bands: as many as a scene without a number of replicates has of these."""


@dataclass(frozen=True)
class Groups:
    """Groups of a scene's replicates.

    Attributes
    ----------
    replicates : int
        Of a stage.
    count : int
        Number of groups: at most the number of replicates, each of which then is a group.
    """

    replicates: int
    count: int

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Return the groups of a scene: without bands, each replicate is one."""
        replicates = scene.transport.replicates
        return cls(replicates, replicates if scene.camera.sensor.bands is None else min(replicates, GROUPS))

    @classmethod
    def single(cls, scene: Scene) -> Self:
        """Return the replicates of a scene as groups of one each: all of them are independent."""
        return cls(scene.transport.replicates, scene.transport.replicates)

    @property
    def joined(self) -> bool:
        """True if there are groups of several replicates."""
        return self.count < self.replicates

    def begun(self, finished: int) -> int:
        """Return the number of groups that the first `finished` replicates of a stage belong to."""
        return min(finished, self.count)

    def place(self, replicate: int) -> tuple[int, Turn]:
        """Return the first replicate of the group of a replicate, whose key the group has, and its turn there.

        Those of a group that follow each other take samples that lie apart, in the order of van der Corput.

        Parameters
        ----------
        replicate : int
            Numbered through, from the first stage to the second.
        """
        stage, number = divmod(replicate, self.replicates)
        member, group = divmod(number, self.count)
        members = len(range(group, self.replicates, self.count))
        order = np.argsort(np.argsort([_radical_inverse(k) for k in range(members)]))
        return stage * self.replicates + group, Turn(int(order[member]), members)


def _radical_inverse(number: int) -> float:
    """Return van der Corput's radical inverse in base 2: the binary digits, mirrored at the point."""
    return int(f"{number:b}"[::-1], 2) / (1 << number.bit_length()) if number else 0.0
