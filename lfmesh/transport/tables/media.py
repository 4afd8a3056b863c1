"""The media of a scene: air, and the glasses of lens, array and bodies in object space, each with a number.

Packets carry the number of the medium that they travel in; the properties of media are the fields of `Media`.
"""

from dataclasses import dataclass

import numpy as np

from lfmesh.optics.glass import Medium, refractive_index
from lfmesh.scene import Scene
from lfmesh.transport.tables.tables import Media


@dataclass(frozen=True)
class MediumList:
    """The distinct media of a scene, by their numbers.

    Attributes
    ----------
    media : tuple of Medium
        Air first.
    """

    media: tuple[Medium, ...]

    @classmethod
    def of(cls, scene: Scene) -> "MediumList":
        """Return the media of a scene."""
        lens = [surface.medium for surface in scene.camera.lens.surfaces]
        mla = [scene.camera.mla.medium] if scene.camera.mla is not None else []
        cover = [scene.camera.sensor.cover.medium] if scene.camera.sensor.cover is not None else []
        bodies = [target.refractor.medium for target in scene.targets if target.refractor is not None]
        return cls(tuple(dict.fromkeys([None, *lens, *mla, *bodies, *cover])))

    def number(self, medium: Medium) -> int:
        """Return the number of a medium."""
        return self.media.index(medium)

    def table(self, wavelengths_nm: tuple[float, ...]) -> Media:
        """Return the media at some wavelengths, as kernels read them."""
        return Media(
            indices=np.array(
                [[refractive_index(medium, wavelength_nm) for wavelength_nm in wavelengths_nm] for medium in self.media]
            )
        )
