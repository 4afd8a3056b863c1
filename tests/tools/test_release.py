"""The trial of a release does what the README says, and refuses what would not be one release."""

import importlib
import shutil
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

from lfmesh.cli import app

ROOT = Path(__file__).resolve().parents[2]
STATING = ("pyproject.toml", "CITATION.cff", "CHANGELOG.md")
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def release(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return importlib.import_module("release")


def test_a_trial_installs_by_the_readmes_pip_and_runs_its_commands(release: ModuleType) -> None:
    install, *commands, script, page = release.steps(README, Path("/dist/lfmesh-1.whl"))
    assert install == ["pip", "install", "/dist/lfmesh-1.whl[browser]"]
    assert {words[1] for words in commands} == {"demo", "check", "render"}
    for words in (*commands, page):
        assert words[0] == "lfmesh"
        app.parse_args(words[1:], exit_on_error=False, print_error=False)
    assert script == ["python", "example.py"]


def test_a_readme_without_pip_is_refused(release: ModuleType) -> None:
    with pytest.raises(release.ReleaseError, match="names no command `pip install`"):
        release.steps(README.replace("pip install", "conda install"), Path("lfmesh-1.whl"))


def test_a_version_that_one_file_states_otherwise_is_refused(release: ModuleType, tmp_path: Path) -> None:
    for name in STATING:
        shutil.copy(ROOT / name, tmp_path)
    version = release.stated_version(tmp_path)
    assert version == release.tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    for name, before, after in (
        ("CITATION.cff", f"\nversion: {version}\n", "\nversion: 0.1.0\n"),
        ("CHANGELOG.md", f"\n## [{version}]", "\n## [0.1.0]"),
    ):
        text = (ROOT / name).read_text(encoding="utf-8")
        assert text.count(before) == 1
        (tmp_path / name).write_text(text.replace(before, after), encoding="utf-8")
        with pytest.raises(release.ReleaseError, match=rf"{version} in pyproject.toml.*0\.1\.0 in {name}"):
            release.stated_version(tmp_path)
        shutil.copy(ROOT / name, tmp_path)


def test_a_wheel_that_lacks_an_asset_is_refused(release: ModuleType, tmp_path: Path) -> None:
    camera = "lfmesh/assets/cameras/lytro_illum.toml"
    wanted = list(release.wanted_in_wheel(ROOT))
    assert {"lfmesh/__init__.py", camera, "lfmesh/assets/docs/index.md"} <= set(wanted)
    wheel = tmp_path / "lfmesh-1.whl"
    for left_out in (None, camera):
        with zipfile.ZipFile(wheel, "w") as file:
            for name in wanted:
                if name != left_out:
                    file.writestr(name, "")
        if left_out is None:
            release.refuse_missing(wheel)
    with pytest.raises(release.ReleaseError, match=rf"lfmesh-1.whl lacks {camera}$"):
        release.refuse_missing(wheel)


def test_a_program_that_fails_or_is_missing_is_named(release: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(release.ReleaseError, match="no-such-python cannot be run"):
        release.run(["no-such-python"], tmp_path)
    with pytest.raises(release.ReleaseError, match="false failed"):
        release.run(["false"], tmp_path)
