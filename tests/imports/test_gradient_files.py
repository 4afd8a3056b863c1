"""OpticStudio's files of gradient-index materials: their kind by their layout, their numbers, their faults."""

from pathlib import Path

import pytest

from lfmesh.errors import SceneError
from lfmesh.imports.gradient_files import GradientFiles, MissingMaterialError
from tests.imports.files import GRADIENT_9, GRADIENT_FILES, PROFILE, SGRIN


def files_of(folder: Path, *texts: str) -> GradientFiles:
    paths = [folder / f"{number}.dat" for number in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text, encoding="utf-8")
    return GradientFiles(folder, tuple(paths))


def test_numbers_are_those_of_the_file(tmp_path):
    files = files_of(tmp_path, *GRADIENT_FILES.values())
    glass = files.dispersion("gsf")
    assert (glass.range_nm, glass.reference_nm) == ((380.0, 2200.0), 587.56)
    assert (len(glass.strengths), len(glass.strengths[0]), glass.strengths[2][5]) == (3, 6, 0.0437821)
    assert glass.resonances_um2[1] == (0.082168, 0.0343531, -0.0337717)
    assert files.dispersion("GTAG").resonances_um2 == ((0.0,), (0.0,), (0.0,))
    rod = files.rod("SLW-1.8")
    assert (rod.index, rod.gradient_constant_per_mm) == ((1.5868, 8.14e-3), (0.3238, 5.364e-3, 2.626e-4))
    blank = files.blank("G41SFN")
    assert (blank.family, blank.length_mm) == ("GSF", 12.1)
    assert (blank.coefficients[0], blank.coefficients[11], len(blank.coefficients)) == (1.7442713, -1.5930068, 12)


def test_a_later_file_has_what_the_first_lacks(tmp_path):
    other = GRADIENT_9.replace("SLS-1.0", "MINE").replace("1.5477", "1.6")
    files = files_of(tmp_path, GRADIENT_9, other)
    assert (files.rod("SLS-1.0").index[0], files.rod("MINE").index[0]) == (1.5477, 1.6)
    assert files.rod("SLW-1.8") == files_of(tmp_path, GRADIENT_9).rod("SLW-1.8")


def test_given_files_take_the_place_of_those_beside_the_lens_file(tmp_path):
    (tmp_path / "gradient_9.dat").write_text(GRADIENT_9.replace("SLS-1.0", "BESIDE"), encoding="utf-8")
    assert GradientFiles(tmp_path).rod("BESIDE").index[0] == 1.5477
    with pytest.raises(MissingMaterialError, match=r"0\.dat has no BESIDE; it has SLS-1\.0, SLW-1\.8"):
        files_of(tmp_path, GRADIENT_9).rod("BESIDE")
    # A file of another kind does not.
    assert files_of(tmp_path, SGRIN).rod("BESIDE").index[0] == 1.5477


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no file of gradient-index materials"),
        ("1 2 3\n4 5 6\n", "no file of gradient-index materials"),
        ("GSF 0.39 1.099\n5.8756E-01\n-0.63\n", "no file of gradient-index materials"),
        (SGRIN.replace("110 0.000285988 0.000362547", "110"), "line 10: 1 words in place of 3 numbers; the material"),
        (SGRIN.replace("6 3", "9 3"), "line 4: K_MAX and L_MAX must be whole numbers from 1 to 8; the material"),
        (SGRIN.replace("6 3", "6 0.5"), "line 4: K_MAX and L_MAX must be whole numbers from 1 to 8; the material"),
        (SGRIN.replace("0.38 2.2", "2.2 0.38"), "wavelengths must be above 0, and rise; the material starts in line 1"),
        (SGRIN.replace("0.58756", "-0.58756"), "wavelengths must be above 0, and rise"),
        (SGRIN.replace("2.44E-05", "nan"), "line 8: 'nan' is not finite"),
        (SGRIN.replace("GTAG\n", "GTAG 1\n"), "line 11: 2 words in place of the name of a material"),
        (SGRIN.rsplit("\n", 2)[0], "the file ends inside a material; the material starts in line 11"),
        (GRADIENT_9.replace("6.37e-3\n", "x\n"), "line 3: 'x' is not a number; the material starts in line 1"),
        (GRADIENT_9 + "SLW-2\n1.5\n", "the file ends inside a material; the material starts in line 13"),
        (PROFILE.replace("12.100", "0"), "line 1: the length of the blank must be above 0"),
        (PROFILE + "G1 GSF\n", "a profile starts with its name, its material and the length of the blank"),
    ],
)  # fmt: skip
def test_a_faulty_file_is_one_line_with_its_place(text, said, tmp_path):
    files = files_of(tmp_path, text)
    for find in (files.dispersion, files.rod, files.blank):
        with pytest.raises(SceneError) as error:
            find("GSF")
        assert str(error.value).startswith(f"{tmp_path / '0.dat'}: ")
        assert said in str(error.value)
        assert "\n" not in str(error.value)


def test_a_missing_given_file_is_named(tmp_path):
    with pytest.raises(SceneError, match=r"none\.dat: cannot be read: No such file"):
        GradientFiles(tmp_path, (tmp_path / "none.dat",)).rod("SLS-1.0")
