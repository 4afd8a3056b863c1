"""Refusals of lens files speak of the file's lines, never of the keys of a scene."""

import re
from pathlib import Path

import pytest

from lfmesh.errors import SceneError
from lfmesh.imports.file_words import file_fault
from lfmesh.imports.prescription import FileSurface
from lfmesh.imports.zemax import read
from tests.imports.files import SINGLET_ZMX

KEYS = re.compile(r"\w+_mm\b|surfaces\[|Lens\.|Surface\.|omit|; give")


def refusal_of(*pairs):
    text = SINGLET_ZMX
    for old, new in pairs:
        assert text.count(old) == 1
        text = text.replace(old, new)
    with pytest.raises(SceneError) as error:
        read(Path("lens.zmx"), text.splitlines())
    return str(error.value)


@pytest.mark.parametrize(
    ("pairs", "line", "why"),
    [
        # Apertures that cross, coefficients beyond all numbers, a step back.
        (
            (
                ("  DISZ 5\n", "  DISZ 0.2\n"),
                ("DIAM 5.2 0 0 0 1", "DIAM 5.2 0 0 0 1\n  CLAP 0 5.2 0"),
            ),
            "line 24: SURF 1",
            "surfaces 0 and 1 cross inside their clear aperture",
        ),
        ((("PARM 2 1e-6", "PARM 2 1e30"),), "line 31: SURF 2", "a sag of more than 1e+15 mm"),
        ((("  DISZ 5\n", "  DISZ -5\n"),), "line 24: SURF 1", "a distance below 0 is supported only"),
    ],
)
def test_a_refusal_names_the_line_and_advises_in_the_language_of_the_file(pairs, line, why):
    said = refusal_of(*pairs)
    assert line in said
    assert why in said
    assert not KEYS.search(said)


def test_the_first_fault_is_put_in_words_whatever_it_is():
    kept = [FileSurface(12, "S 1 2"), FileSurface(0, "surfaces 2")]
    several = "2 faults\n  Surface.radius_mm = 0.0: must not be 0; give inf\n  Surface.conic = 1e99: too large"
    assert file_fault(several, kept, 0) == "line 12: S 1 2: surface 0 of the lens: radius, mm = 0.0: must not be 0"
    other = "Lens.surfaces[1].thickness_mm: missing"
    assert file_fault(other, kept).startswith("surfaces 2: surface 1 of the lens: ")
    assert file_fault("Lens.f_number = 0.0: must be above 0", kept) == "as a lens of this program: " + (
        "Lens.f_number = 0.0: must be above 0"
    )
