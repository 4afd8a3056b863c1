"""The lenses of the library, one line each."""

from dataclasses import dataclass

from lfmesh.optics.glass import D_LINE_NM
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.files import LIBRARY, library, load_lens
from lfmesh.scene.first_order.paraxial import Paraxial


@dataclass(frozen=True)
class Entry:
    """A lens of the library.

    Attributes
    ----------
    name : str
        Name that follows "lib:" in a scene file.
    lens : Lens
    efl_mm : float
        Focal length at the d line.
    f_number : float
        Focal length over the diameter of the entrance pupil.
    """

    name: str
    lens: Lens
    efl_mm: float
    f_number: float

    def __str__(self) -> str:
        count = sum(map(self.lens.has_glass_behind, range(len(self.lens.surfaces))))
        return (
            f"{LIBRARY}{self.name}: {self.lens.name}; {self.efl_mm:.5g} mm, f/{self.f_number:.3g}, {count} "
            f"element{'' if count == 1 else 's'}; {self.lens.source}"
        )


def entries() -> list[Entry]:
    """Return the lenses of the library, in order of name."""
    return [_entry(name) for name in library()]


def _entry(name: str) -> Entry:
    lens = load_lens(LIBRARY + name)
    paraxial = Paraxial.of(lens, D_LINE_NM)
    f_number = lens.f_number
    if f_number is None:
        radius = lens.aperture_mm(paraxial.stop) or 1.0
        f_number = abs(paraxial.efl_mm) / (lens.epd_mm or paraxial.entrance_pupil(radius)[1])
    return Entry(name, lens, paraxial.efl_mm, f_number)
