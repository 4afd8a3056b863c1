"""Garbage under the name of a lens file ends in one clear line, quickly."""

import json

import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.scene import load_lens
from tests.imports.files import GRADIENTS_ZMX, PHASES_SEQ, PHASES_ZMX, SINGLET_SEQ, SINGLET_ZMX
from tests.imports.test_coatings import FILE as COATINGS
from tests.imports.test_lens_table import text as table
from tests.imports.test_optiland_json import LENS as OPTILAND
from tests.imports.test_oslo import LENS as LEN
from tests.instances import instances
from tests.processor_time import processor_seconds

FILES = [
    (".zmx", SINGLET_ZMX),
    (".zmx", PHASES_ZMX),
    (".zmx", GRADIENTS_ZMX),
    (".seq", SINGLET_SEQ),
    (".seq", PHASES_SEQ),
    (".len", LEN),
    (".json", json.dumps(OPTILAND, indent=1)),
    (".csv", "\n".join(table(" ; "))),
]
GARBAGE = {
    "empty": (b"", "it has no line S"),
    "zeros": (bytes(100_000), "not text"),
    "noise": (np.random.default_rng(1).bytes(200_000), "not text"),
    "large": (b"x " * 5_000_000, "larger than 8 MB"),
    "lines": (b"\n" * 2_000_000, "more than 100000 lines"),
    "words": (b"CURV " + b"9" * 4_000_000, "it has no line S|before the first"),
    "half of UTF-16": (SINGLET_ZMX.encode("utf-16")[:-1], "cut short"),
    "a picture": (b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 10, "not text"),
}


def outcome(path):
    """The message of the error that reading ends in; the path where there is none."""
    try:
        load_lens(path)
    except SceneError as error:
        return str(error)
    return str(path)


@pytest.mark.parametrize("ending", [".zmx", ".seq"])
@pytest.mark.parametrize("kind", GARBAGE)
def test_garbage_is_one_line(tmp_path, ending, kind):
    data, reason = GARBAGE[kind]
    path = tmp_path / f"lens{ending}"
    path.write_bytes(data)
    start = processor_seconds()
    with pytest.raises(SceneError, match=reason) as error:
        load_lens(path)
    assert len(str(error.value)) < 600
    assert processor_seconds() - start < 20.0


@pytest.mark.parametrize(("ending", "line"), [(".zmx", "SURF 1\n"), (".seq", "S 1 1\n")])
def test_surfaces_without_end_are_refused(tmp_path, ending, line):
    path = tmp_path / f"lens{ending}"
    path.write_text(("SO 0 1e14\n" if ending == ".seq" else "") + 5000 * line)
    with pytest.raises(SceneError, match="more than 1000 surfaces"):
        load_lens(path)


@pytest.mark.parametrize(("ending", "text"), FILES)
@pytest.mark.filterwarnings("ignore::lfmesh.errors.LensFileWarning")
def test_any_cut_of_a_file_is_a_lens_or_one_clear_error(tmp_path, ending, text):
    path = tmp_path / f"lens{ending}"
    for end in range(0, len(text), max(7, len(text) // 100)):
        path.write_text(text[:end])
        assert str(path) in outcome(path)


@pytest.mark.parametrize("seed", instances([2, 3, 4], long=[3, 4]))
@pytest.mark.parametrize(("ending", "text"), FILES)
@pytest.mark.filterwarnings("ignore::lfmesh.errors.LensFileWarning")
def test_changed_words_make_a_lens_or_one_clear_error(tmp_path, ending, text, seed):
    draw = np.random.default_rng(seed)
    path = tmp_path / f"lens{ending}"
    words = text.split(" ")
    strange = [
        "-1",
        "0",
        "1e400",
        "nan",
        "1e-320",
        "STOP",
        "'",
        '"',
        "&",
        ";",
        "S",
        "\n",
        "99999999999999999999",
        "S1..3",
    ]
    for _ in range(100):
        new = list(words)
        for place in draw.integers(len(new), size=draw.integers(1, 4)):
            new[place] = strange[draw.integers(len(strange))]
        path.write_text(" ".join(new))
        assert str(path) in outcome(path)


@pytest.mark.filterwarnings("ignore::lfmesh.errors.LensFileWarning")
def test_a_changed_coating_file_makes_a_lens_or_one_clear_error(tmp_path):
    draw = np.random.default_rng(3)
    path = tmp_path / "lens.zmx"
    names = iter(["GROUPS", "MEASURED"])
    path.write_text(
        "".join(
            f"{line}\n  COAT {next(names)}\n" if line in ("SURF 1", "SURF 2") else f"{line}\n"
            for line in SINGLET_ZMX.split("\n")
        )
    )
    words = COATINGS.split(" ")
    strange = ["-1", "0", "1e400", "nan", "1e-320", "1_0", "COAT", "MATE", "TABLE", "!", "\n", "99999999999999999999"]
    for _ in range(100):
        new = list(words)
        for place in draw.integers(len(new), size=4):
            new[place] = strange[draw.integers(len(strange))]
        (tmp_path / "COATING.DAT").write_text(" ".join(new))
        assert str(path) in outcome(path)


def test_a_folder_and_a_missing_file(tmp_path):
    for name in ("missing.zmx", "folder.zmx"):
        path = tmp_path / name
        if name.startswith("folder"):
            path.mkdir()
        with pytest.raises(SceneError, match="cannot be read"):
            load_lens(path)
