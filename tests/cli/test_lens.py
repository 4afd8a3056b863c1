"""lfmesh lens list and convert: what they print, what they write, what they refuse."""

import re
from pathlib import Path

import pytest

from lfmesh.cli import main
from lfmesh.scene import load_lens, loads
from lfmesh.scene.files import library
from tests.imports.files import SINGLET_SEQ, SINGLET_ZMX

SCENE = """
schema_version = 1
[camera]
focus_mm = 500.0
[camera.lens]
file = "{}"
[camera.sensor]
pixels = [32, 32]
pixel_mm = 0.02
"""


def test_every_lens_of_the_library_is_listed_with_its_focal_length_and_source(capsys):
    assert main(["lens", "list"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert [word.removeprefix("lib:").rstrip(":") for word in out.split() if word.startswith("lib:")] == library()
    assert "lib:tessar_50mm: Tessar 50 mm f/4.5; 49.972 mm, f/4.5, 4 elements; M. Laikin" in out


def test_a_scene_names_a_lens_of_the_library():
    assert loads(SCENE.format("lib:tessar_50mm")).camera.lens == load_lens("lib:tessar_50mm")
    with pytest.raises(Exception, match=r"no lens 'lib:tesar_50mm' \(did you mean 'tessar_50mm'\?\)"):
        loads(SCENE.format("lib:tesar_50mm"))
    with pytest.raises(Exception, match="no lens"):
        loads(SCENE.format("lib:../lenses/tessar_50mm"))


def test_conversion_says_what_became_of_the_lines(tmp_path: Path, capsys):
    (tmp_path / "in.zmx").write_text(SINGLET_ZMX.replace("CLAP 0 6.25 0", "SQAP 3 4 0"))
    assert main(["lens", "convert", str(tmp_path / "in.zmx"), str(tmp_path / "out.toml")]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "line 40: SQAP 3 4 0: approximated: a rectangular aperture: the circle around it" in out
    assert "lines: 37 taken, 1 approximated, 8 without effect" in out
    assert load_lens(tmp_path / "out.toml").surfaces[1].semi_diameter_mm == 5.0


def test_a_lens_without_lines_of_another_program_says_nothing_of_lines(tmp_path: Path, capsys) -> None:
    assert main(["lens", "convert", "lib:tessar_50mm", str(tmp_path / "out.toml")]) == 0
    assert capsys.readouterr().out == f"  {tmp_path / 'out.toml'}\n"


def test_a_glass_may_be_replaced_in_conversion(tmp_path: Path, capsys):
    (tmp_path / "in.seq").write_text(SINGLET_SEQ.replace("NBK7_SCHOTT", "BK77_SCHOTT"))
    words = ["lens", "convert", str(tmp_path / "in.seq"), str(tmp_path / "out.zmx")]
    assert main(words) == 2
    assert "SCHOTT/N-BK7" in capsys.readouterr().err
    assert main([*words, "--glass", "BK77_SCHOTT=SCHOTT/N-BK7"]) == 0
    assert load_lens(tmp_path / "out.zmx").surfaces[0].glass == "SCHOTT/N-BK7"


def test_every_line_is_listed_in_the_order_of_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in.zmx").write_text(SINGLET_ZMX)
    assert main(["lens", "convert", str(tmp_path / "in.zmx"), str(tmp_path / "out.toml"), "--lines"]) == 0
    numbers = [int(number) for number in re.findall(r"^line (\d+):", capsys.readouterr().out, flags=re.MULTILINE)]
    assert len(numbers) > 40
    assert numbers == sorted(numbers)


@pytest.mark.parametrize(
    ("wavelengths", "noted"),
    [
        ("", True),
        ("\n[transport]\nwavelengths_nm = [587.6]", False),
        ("\n[transport]\nwavelengths_nm = [850.0]", False),
    ],
)
def test_a_scene_without_wavelengths_is_told_those_of_its_lens_file(
    wavelengths: str, noted: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wave = re.compile(r"^WAVM 2 .*$", flags=re.MULTILINE)
    (tmp_path / "in.zmx").write_text(wave.sub("WAVM 2 0.850 1", SINGLET_ZMX))
    (tmp_path / "scene.toml").write_text(SCENE.format("in.zmx") + wavelengths)
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert (
        "in.zmx: its primary wavelength is 850 nm, but the scene names none and is traced at 587.6 nm" in said
    ) == noted


def test_a_command_notes_what_is_doubtful_in_the_scenes_lens_file(tmp_path: Path, capsys):
    (tmp_path / "in.zmx").write_text(SINGLET_ZMX.replace("CLAP 0 6.25 0", "SQAP 3 4 0"))
    (tmp_path / "scene.toml").write_text(SCENE.format("in.zmx"))
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    err = " ".join(capsys.readouterr().err.split())
    assert err.startswith("Note: ")
    assert err.endswith(": approximated: a rectangular aperture: the circle around it [LensFileWarning]")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["lib:tessar_50mm", "out.len"], "a lens is written to .toml, .zmx or .seq"),
        (["missing.zmx", "out.toml"], "missing.zmx: cannot be read"),
        (["lib:tessar_50mm", "out.toml", "--glass", "BK7"], "write NAME=GLASS or NAME=INDEX"),
    ],
)
def test_mistakes_are_one_message(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["lens", "convert", *words]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
