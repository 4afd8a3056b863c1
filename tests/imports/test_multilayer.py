"""Coatings of CODE V's multilayer files, against what CODE V prints of them.

Stacks and printed figures: listings of CODE V 11.2 in the tests of TFStudio (github.com/aai2k/TFStudio,
tests/reference/codev). The files are written here, in the layout that `lfmesh.imports.multilayer` gives.
"""

from pathlib import Path

import numpy as np
import pytest
import tmm

import lfmesh as lf
from lfmesh.imports import codev
from lfmesh.imports.coatings import UnreadableCoatingError
from lfmesh.imports.multilayer import multilayer
from lfmesh.imports.report import Verdict
from lfmesh.scene.materials.coatings import Coating
from tests.imports.files import SINGLET_SEQ

BK7 = {400.0: (1.530849, 0.0), 520.0: (1.52016, 0.0), 550.0: (1.518522, 0.0), 560.0: (1.518032, 0.0)}
SIO2 = {400.0: (1.470116, 0.0), 520.0: (1.46128, 0.0), 560.0: (1.4595, 0.0)}
TA2O5 = {400.0: (2.1587, 0.000761), 520.0: (2.151057, 0.000795), 560.0: (2.138067, 0.000864)}
AT_REFERENCE = {"SiO2": 1.459911343, "Ta2O5": 2.141063672, "BK7": 1.518522332}
"""Indices at 550 nm that CODE V made of its tables."""
TABLES = {"SiO2": SIO2, "Ta2O5": TA2O5, "BK7": BK7}
METAL = [(58.5, (2.35, 0.0)), (99.6, (1.38, 0.0)), (12.0, (2.75, 4.46)), (99.6, (1.38, 0.0))]
FOUR = [(92.5, "SiO2"), (112.0, "Ta2O5"), (30.6, "SiO2"), (14.4, "Ta2O5")]


def block(values, per_line, form) -> str:
    """Return numbers in lines of a fixed number."""
    lines = [values[k : k + per_line] for k in range(0, len(values), per_line)]
    return "".join("".join(form(value) for value in line) + "\n" for line in lines)


def ints(values) -> str:
    return block(list(values), 8, "{:10d}".format)


def reals(values) -> str:
    # Fortran leaves the E out before an exponent of three digits.
    return block(
        [np.float32(v) for v in values], 4, lambda v: f"{v:20.10G}" if v else f"{0.6e-153:20.10E}".replace("E", "")
    )


def labels(names) -> str:
    rows = [names[k : k + 7] for k in range(0, len(names), 7)]
    heads = [f"{len(names):10d}", *[" " * 10] * len(rows)]
    return "".join(head + "".join(f"{name:10}" for name in row) + "\n" for head, row in zip(heads, rows, strict=False))


def written(layers, incident="air", substrate="BK7", reference_nm=550.0, sampled_nm=(400.0, 520.0), kind=6) -> str:
    """Return a multilayer file: each layer a thickness, nm, and n and k or the name of a table."""
    media = [(0.0, incident), *layers, (0.0, substrate)]
    media = [(thickness, (1.0, 0.0) if index == "air" else index) for thickness, index in media]
    used = list(dict.fromkeys(index for _, index in media if isinstance(index, str)))
    catalogue, links, group, previous = [], [], None, 0
    for name in used:
        # Tables of the same wavelengths share a group, so that both ways from one to the next are there.
        nm, n, k = list(TABLES[name]), *zip(*TABLES[name].values(), strict=True)
        start = len(catalogue)
        if group is not None:
            links[previous] = start + 1
        shared = [] if nm == group else [wave / 1e3 for wave in nm]
        catalogue += [*shared, 0.0, *n, *k]
        links += [0] * (len(catalogue) - start)
        if shared:
            links[start : start + 2] = [len(nm), start + len(nm) + 1]
        group, previous = nm, start + len(shared) + 1
    start = len(catalogue) + 1
    places = {}
    for name in used:
        places[name] = len(catalogue) + 1
        near = [min(TABLES[name], key=lambda wave, line=line: abs(wave - line)) for line in sampled_nm]
        catalogue += [0.0, *(TABLES[name][wave][0] for wave in near), *(TABLES[name][wave][1] for wave in near)]
    catalogue.append(0.0)
    links += [0] * (len(catalogue) - len(links))
    counts = [0] * 45
    counts[16:19], counts[22], counts[26], counts[35] = (
        [len(media), len(sampled_nm), len(catalogue)],
        25,
        len(media) - 1,
        start,
    )
    settings = [0.0] * 25
    settings[6] = reference_nm / 1e3
    n = [AT_REFERENCE[index] if isinstance(index, str) else index[0] for _, index in media]
    waves = [thickness * at / reference_nm for (thickness, _), at in zip(media, n, strict=True)]
    return (
        f"{kind:10d}{0.0:16.9f}\nA coating\n    07-Oct-26 PLAINTEXT\n" + ints([0, 9600, 10233, 1010, 0]) + ints(counts)
        + ints([0] * 12) + ints([0] * len(media)) + ints(places[i] if isinstance(i, str) else -1 for _, i in media)
        + ints(links) + reals(settings) + reals(line / 1e3 for line in sampled_nm) + reals(sampled_nm) * 4
        + reals(waves) + reals(0.0 if isinstance(i, str) else i[1] for _, i in media) + reals(n)
        + labels([*used, *used]) + reals(catalogue) + labels(used)
    )  # fmt: skip


def passed(coating: Coating, nm: float, substrate: float) -> tuple[float, float]:
    """Return reflectance and transmittance at normal incidence from air to a substrate."""
    indices = [
        layer.measured.at(nm) if layer.measured is not None else complex(layer.index or 0.0, layer.extinction)
        for layer in coating.layers or ()
    ]
    thicknesses = [layer.thickness_nm for layer in coating.layers or ()]
    found = tmm.coh_tmm("s", [1.0, *indices, substrate], [np.inf, *thicknesses, np.inf], 0.0, nm)
    return found["R"], found["T"]


@pytest.mark.parametrize(
    ("layers", "nm", "reflected", "transmitted"),
    [
        (METAL, 400.0, 0.452646, 0.103821),
        (METAL, 550.0, 0.771485, 0.057384),
        (FOUR, 400.0, 0.025689, 0.971147),
        (FOUR, 520.0, 0.004654, 0.992831),
        (FOUR, 560.0, 0.002405, 0.995073),
    ],
)
@pytest.mark.parametrize("kind", [5, 6])
def test_coatings_reflect_what_code_v_prints(tmp_path: Path, layers, nm, reflected, transmitted, kind) -> None:
    (tmp_path / "stack.mul").write_text(written(layers, kind=kind))
    coating = multilayer(tmp_path / "stack.mul").coating
    assert len(coating.layers or ()) == 4
    np.testing.assert_allclose(passed(coating, nm, BK7[nm][0]), (reflected, transmitted), rtol=0.0, atol=1.5e-6)


def test_a_lens_has_the_multilayers_that_it_names(tmp_path: Path) -> None:
    """The second face's coating was designed from the glass to the air."""
    (tmp_path / "front.mul").write_text(written(FOUR))
    (tmp_path / "back.mul").write_text(written(METAL[::-1], incident="BK7", substrate="air"))
    text = SINGLET_SEQ.replace("  STO\n", "  STO\n  MLT 'C:\\coatings\\front.mul'\n").replace(
        "GO\n", "MLT S2 back\nGO\n"
    )
    lens, report = codev.read(tmp_path / "lens.seq", text.splitlines())
    assert [surface.coating for surface in lens.surfaces[:2]] == ["front", "back"]
    front, back = lens.coatings["front"].layers or (), lens.coatings["back"].layers or ()
    assert [layer.thickness_nm for layer in front] == pytest.approx([92.5, 112.0, 30.6, 14.4], rel=1e-6)
    assert [layer.thickness_nm for layer in back] == pytest.approx([58.5, 99.6, 12.0, 99.6], rel=1e-6)
    assert sum("from the incident medium onwards" in line.how for line in report.of(Verdict.APPROXIMATED)) == 2


def test_light_through_a_coated_window_is_what_code_v_prints(tmp_path: Path) -> None:
    (tmp_path / "stack.mul").write_text(written(METAL))
    layers = multilayer(tmp_path / "stack.mul").coating
    window = [
        lf.Surface(index=BK7[550.0][0], thickness_mm=2.0, semi_diameter_mm=5.0, coating="stack"),
        lf.Surface(thickness_mm=1.0, semi_diameter_mm=5.0),
        lf.Surface(stop=True, semi_diameter_mm=4.0),
    ]
    camera = {
        "lens": {"surfaces": window, "coatings": {"stack": layers}},
        "sensor": {"pixels": (10, 10), "pixel_mm": 1.0, "distance_mm": 5.0},
    }
    scene = lf.Scene(camera=camera, transport={"wavelengths_nm": [550.0]})
    paths = lf.trace(lf.build(scene, aimed=False), [[0.0, 0.0, -5.0]], [[0.0, 0.0, 1.0]], 550.0, split="transmit")
    bare = 1.0 - ((BK7[550.0][0] - 1.0) / (BK7[550.0][0] + 1.0)) ** 2
    assert paths.weight[0] / bare == pytest.approx(0.057384, abs=1.5e-6)


@pytest.mark.parametrize("layers", [METAL, FOUR])
def test_a_file_that_is_cut_or_changed_is_said_to_be_none(tmp_path: Path, layers) -> None:
    path, lines = tmp_path / "stack.mul", written(layers).splitlines()
    # What follows the catalogue is not read.
    for end in range(len(lines) - 1):
        path.write_text("\n".join(lines[:end]))
        with pytest.raises(UnreadableCoatingError, match=r"stack\.mul"):
            multilayer(path)
    for number, word in ((0, "7 0.0"), (4, "0 0 x"), (10, "0 0 0"), (len(lines) // 2, "1 2 3 4 5 6 7 8 9")):
        path.write_text("\n".join([*lines[:number], word, *lines[number + 1 :]]))
        with pytest.raises(UnreadableCoatingError, match=r"stack\.mul"):
            multilayer(path)
    with pytest.raises(UnreadableCoatingError, match=r"other\.mul: cannot be read"):
        multilayer(tmp_path / "other.mul")
