"""Gradient-index glass of Zemax files: GRINSUR1 is the surface Gradient 1, GRINSUR8 GRADIUM, GRINSU12 Gradient 12.

`lfmesh.optics.gradient_shapes` has the formulas. Parameter 1 is the program's step. The others, by OpticStudio's help,
24.2 (Gradient 10: 25.1), "Gradient 1" to "Gradient 12" and "GRADIUM":

| type | parameters | material |
|---|---|---|
| GRINSUR1 | 2 n₀, 3 nr2, 4 nr1 | |
| GRINSUR2 | 2 n₀, 3 to 8 nr2 to nr12, of n² | |
| GRINSUR3 | 2 n₀, 3 to 5 nr2 to nr6, 6 to 8 nz1 to nz3 | |
| GRINSUR4 | 2 n₀, 3 nx1, 4 nx2, 5 ny1, 6 ny2, 7 nz1, 8 nz2 | |
| GRINSUR5 | 2 n₀, 3 nr2, 4 nr4, 5 to 8 nz1 to nz4, 9 and 10 tilts | of SGRIN.DAT, or none |
| GRINSUR7 | 2 n₀, 3 R (0: that of the surface), 4 α, 5 β | |
| GRINSUR8 | 2 Δz, 3 index at the vertex, by the program | of PROFILE.GRD |
| GRINSUR9 | 2 and 3 tilts | of GRADIENT_9.DAT |
| GRINSU10 | 2 n₀, 3 to 8 ny1 to ny6 | of SGRIN.DAT, or none |
| GRINSU12 | 2 order, 3 n₀, 4 to 63 cx1, cy1, cz1, cx2, ... | of SGRIN.DAT, or none |

GRIN interconnect (GRINSUR1), Selfoc lens (GRINSUR9) and sc_grin3 (GRINSUR8), samples of OpticStudio, confirm their
types, places and formulas by the image sizes that they store. sc_grin3 also stores parameter 0 of GRINSUR8, the length
of its blank in PROFILE.GRD. No public file confirms that n₀ of GRINSUR2 is n² on the axis; the report says so.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field

from lfmesh.imports import gradient_keys
from lfmesh.imports.gradient_files import FileDispersion, MissingMaterialError
from lfmesh.imports.gradient_keys import OWN_RADIUS, GradientKeys
from lfmesh.imports.prescription import Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.zemax_lines import SurfaceLines, UnreadableLineError
from lfmesh.imports.zemax_tables import BEFORE_EXTRA
from lfmesh.scene.quantities import LARGEST

HIGHEST_ORDER = 20
"""Highest power of x, y and z in GRINSU12."""

STEP = 1
"""Parameter of the program's step through the glass."""

_GRADIUM, _SELFOC = "GRINSUR8", "GRINSUR9"

_DISPERSIVE = ("GRINSUR5", "GRINSU10", "GRINSU12")
"""Types with an optional material of SGRIN.DAT."""

_BY_PROGRAM = (0, 3)
"""Parameters of GRADIUM that the program computes."""

_SAME_INDEX = 1e-6
"""Largest difference of the stored index at the vertex from that of the profile."""

_TILTED = "a surface with a tilt term is not supported; put coordinate breaks around it"


@dataclass
class GradientLines(SurfaceLines):
    """Lines of a surface in front of gradient-index glass.

    Attributes
    ----------
    doubts : list of str
        Ways in which the glass may differ from the program's.
    """

    doubts: list[str] = field(default_factory=list)

    def take(self, made: Prescription, report: Report) -> None:
        """Give the surface its gradient, and the lines their verdicts.

        Parameters
        ----------
        made : Prescription
        report : Report

        Raises
        ------
        SceneError
            A file of materials cannot be read.
        """
        surface = self.surface
        glass_line = surface.glass_line or (self.at, self.text)
        try:
            self._check(glass_line)
            surface.gradient = READERS[self.kind](self, made)
        except UnreadableLineError as error:
            report.refuse(error.at, error.text, str(error))
            return
        except MissingMaterialError as error:
            report.refuse(*glass_line, str(error))
            return
        finally:
            # The material is no glass of a catalogue.
            surface.glass = surface.stated_index = surface.stated_abbe = None
        unused = (STEP, *(_BY_PROGRAM if self.kind == _GRADIUM else ()))
        for place, value in self.parameters.items():
            report.add(value.at, value.text, Verdict.WITHOUT_EFFECT if place in unused else Verdict.TAKEN)
        for value in self.extra.values():
            report.add(value.at, value.text, Verdict.TAKEN)
        how = "; ".join(self.doubts)
        report.add(self.at, self.text, Verdict.APPROXIMATED if how else Verdict.TAKEN, how)

    def _check(self, glass_line: tuple[int, str]) -> None:
        """Raise for numbers out of range, and for a glass that the type does not have."""
        for value in (*self.parameters.values(), *self.extra.values()):
            if abs(value.number) > LARGEST:
                raise self.error(f"a number must be {LARGEST:g} or less in magnitude", value)
        named = self.kind in (_GRADIUM, _SELFOC, *_DISPERSIVE)
        if self.surface.model is not None or (self.surface.glass is not None and not named):
            has = "takes the name of a material" if named else "has its index in its parameters"
            raise UnreadableLineError(*glass_line, f"{self.kind} {has}")
        if self.kind in (_GRADIUM, _SELFOC) and self.surface.glass is None:
            raise self.error(f"{self.kind} needs the name of a material, GLAS")

    @property
    def material(self) -> str:
        """Name of the material; empty if there is none."""
        return self.surface.glass or ""

    @property
    def base_index(self) -> float:
        """The index n₀ in parameter 2."""
        return self.needed(2, "the index n₀").number

    def values(self, places: Sequence[int]) -> list[float]:
        """Return parameters; 0 where the file has none."""
        return [self.parameter(place) for place in places]

    def only_up_to(self, last: int, first: int = STEP) -> None:
        """Raise for other parameters than these, and for extra data, unless they are 0."""
        self.only(range(first, last + 1))
        for value in self.extra.values():
            if value.number:
                raise self.error(f"{self.kind} has no extra data", value)

    def zero(self, places: Sequence[int], why: str) -> None:
        """Raise for a parameter other than 0."""
        for place in places:
            if self.parameter(place):
                raise self.error(why, self.parameters[place])

    def in_mm_only(self, made: Prescription) -> None:
        """Raise unless the file's unit is that of the materials."""
        if made.unit_mm != 1.0:
            raise self.error(f"the numbers of {self.material} are in mm; a file in another unit is not supported")

    def finished(self, made: Prescription, index: float, keys: GradientKeys | None) -> GradientKeys | None:
        """Return a gradient with the dispersion of its material, if any.

        Parameters
        ----------
        made : Prescription
        index : float
            At the vertex.
        keys : dict or None
            The gradient; None: constant, which without a material becomes the surface's index.

        Returns
        -------
        dict or None
        """
        if not self.material:
            self.surface.model = None if keys else (index, 0.0)
            return keys
        given = keys or {"kind": "axial", "index": index, "coefficients": (0.0,)}
        return given | self.dispersion_keys(made, self.material)

    def dispersion_keys(self, made: Prescription, material: str) -> GradientKeys:
        """Return the key of a dispersion, and note wavelengths beyond its data.

        Parameters
        ----------
        made : Prescription
        material : str
            Name in SGRIN.DAT.

        Returns
        -------
        dict
        """
        found: FileDispersion = made.gradient_files.dispersion(material)
        lowest, highest = found.range_nm
        beyond = [f"{line:g}" for line in made.wavelengths_nm if not lowest <= line <= highest]
        if beyond:
            self.doubts.append(
                f"at {', '.join(beyond)} nm, outside the data of {material} from {lowest:g} to {highest:g} nm, its "
                "formula is taken"
            )
        return {"dispersion": found.keys}


def _gradient_1(lines: GradientLines, made: Prescription) -> GradientKeys | None:
    lines.zero([4], "a term in r makes a cone of the index, which has no gradient on the axis; it is not supported")
    lines.only_up_to(4)
    index = lines.base_index
    return lines.finished(made, index, gradient_keys.radial_and_axial(index, lines.values([3]), [], made.unit_mm))


def _gradient_2(lines: GradientLines, made: Prescription) -> GradientKeys | None:
    lines.only_up_to(8)
    squared = lines.base_index
    if not squared > 0.0:
        raise lines.error("n² on the axis must be above 0", lines.parameters[2])
    lines.doubts.append(f"parameter 2 is taken as n² on the axis, so that n = {squared**0.5:.6g}")
    return lines.finished(
        made, squared**0.5, gradient_keys.radial_square(squared, lines.values(range(3, 9)), made.unit_mm)
    )


def _gradient_3(lines: GradientLines, made: Prescription) -> GradientKeys | None:
    lines.only_up_to(8)
    index, radial, axial = lines.base_index, lines.values(range(3, 6)), lines.values(range(6, 9))
    return lines.finished(made, index, gradient_keys.radial_and_axial(index, radial, axial, made.unit_mm))


def _gradient_4(lines: GradientLines, made: Prescription) -> GradientKeys | None:
    lines.only_up_to(8)
    index, pairs = lines.base_index, [lines.values([place, place + 1]) for place in (3, 5, 7)]
    return lines.finished(made, index, gradient_keys.xyz(index, pairs, made.unit_mm))


def _gradient_5(lines: GradientLines, made: Prescription) -> GradientKeys | None:
    lines.zero([9, 10], _TILTED)
    lines.only_up_to(10)
    index, radial, axial = lines.base_index, lines.values([3, 4]), lines.values(range(5, 9))
    return lines.finished(made, index, gradient_keys.radial_and_axial(index, radial, axial, made.unit_mm))


def _gradient_7(lines: GradientLines, made: Prescription) -> GradientKeys | None:
    lines.only_up_to(5)
    index, radius = lines.base_index, lines.parameter(3) or OWN_RADIUS
    keys = gradient_keys.spherical(index, lines.values([4, 5]), radius, made.unit_mm)
    return lines.finished(made, index, keys)


def _gradium(lines: GradientLines, made: Prescription) -> GradientKeys | None:
    why = "a profile that is capped, decentred or tilted is not supported"
    lines.zero([place for place in lines.parameters if place > _BY_PROGRAM[-1]], why)
    lines.only_up_to(BEFORE_EXTRA, 0)
    lines.in_mm_only(made)
    blank, offset, stored = made.gradient_files.blank(lines.material), lines.parameter(2), lines.parameter(3)
    at_vertex = sum(n * (offset / blank.length_mm) ** i for i, n in enumerate(blank.coefficients))
    if stored and not abs(at_vertex - stored) <= _SAME_INDEX:
        lines.doubts.append(f"the file has n = {stored:.9g} at the vertex, its profile {at_vertex:.9g}, which is taken")
    keys = {"kind": "gradium", "coefficients": blank.coefficients, "blank_mm": blank.length_mm, "offset_mm": offset}
    return keys | lines.dispersion_keys(made, blank.family)


def _selfoc(lines: GradientLines, made: Prescription) -> GradientKeys | None:
    lines.zero([2, 3], _TILTED)
    lines.only_up_to(3)
    lines.in_mm_only(made)
    return {"kind": "selfoc", **asdict(made.gradient_files.rod(lines.material))}


def _gradient_10(lines: GradientLines, made: Prescription) -> GradientKeys | None:
    lines.zero([3, 5, 7], "an odd power of |y| makes a kink of the index at y = 0, which is not supported")
    lines.only_up_to(8)
    index = lines.base_index
    return lines.finished(made, index, gradient_keys.xyz(index, [[], lines.values(range(3, 9)), []], made.unit_mm))


def _gradient_12(lines: GradientLines, made: Prescription) -> GradientKeys | None:
    order = lines.needed(2, "the order")
    if order.number not in range(HIGHEST_ORDER + 1):
        raise lines.error(f"the order must be a whole number up to {HIGHEST_ORDER}", order)
    lines.only(range(STEP, BEFORE_EXTRA + 1))
    index, counted = lines.needed(3, "the index n₀").number, int(order.number)
    # Versions differ in whether parameters beyond 12 are extra data.
    held = lines.values(range(BEFORE_EXTRA + 1)) + [0.0] * (3 * HIGHEST_ORDER)
    for place, value in lines.extra.items():
        if not 1 <= place <= 3 * HIGHEST_ORDER + 3 - BEFORE_EXTRA:
            raise lines.error(f"{lines.kind} has no such number", value)
        held[BEFORE_EXTRA + place] = value.number
    terms = [[held[4 + axis + 3 * i] for i in range(counted)] for axis in range(3)]
    return lines.finished(made, index, gradient_keys.xyz(index, terms, made.unit_mm))


READERS: dict[str, Callable[[GradientLines, Prescription], GradientKeys | None]] = {
    "GRINSUR1": _gradient_1,
    "GRINSUR2": _gradient_2,
    "GRINSUR3": _gradient_3,
    "GRINSUR4": _gradient_4,
    "GRINSUR5": _gradient_5,
    "GRINSUR7": _gradient_7,
    _GRADIUM: _gradium,
    _SELFOC: _selfoc,
    "GRINSU10": _gradient_10,
    "GRINSU12": _gradient_12,
}
"""Readers of surfaces in front of gradient-index glass, by Zemax's type."""
