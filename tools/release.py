"""Build the distributions of lfmesh, and try the wheel in an empty environment as a user would.

    tools/release --dry-run [PYTHON ...]

Builds into dist/. For each Python a new environment in a temporary folder gets the wheel with its extra `browser`; the
scene, commands and script of the README run there, and `lfmesh view --html` writes a page.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
README = (ROOT / "README.md").read_text(encoding="utf-8")

WANTED_IN_WHEEL = ("lfmesh/__init__.py", "lfmesh/assets/scenes/first_light.toml", "lfmesh/assets/docs/index.md")


def main(pythons: list[str]) -> int:
    shutil.rmtree(DIST, ignore_errors=True)
    run([sys.executable, "-m", "build", "--outdir", str(DIST), str(ROOT)], ROOT)
    (wheel,) = DIST.glob("*.whl")
    held = set(zipfile.ZipFile(wheel).namelist())
    if missing := [name for name in WANTED_IN_WHEEL if name not in held]:
        print(f"tools/release: {wheel.name} lacks {', '.join(missing)}", file=sys.stderr)
        return 1
    for python in pythons or [sys.executable]:
        begun = time.perf_counter()
        with tempfile.TemporaryDirectory(prefix="lfmesh-release-") as folder:
            said = tried(python, wheel, Path(folder))
        print(f"{said}: {wheel.name} installs, renders and views; {time.perf_counter() - begun:.0f} s")
    return 0


def tried(python: str, wheel: Path, folder: Path) -> str:
    """Install the wheel for a Python into an empty environment, and do what the README says; return its version."""
    home, work = folder / "environment", folder / "work"
    work.mkdir()
    run([python, "-m", "venv", str(home)], work)
    inside = str(home / "bin" / "python")
    run([inside, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", f"{wheel}[browser]"], work)
    for text, name in ((block("toml"), "scene.toml"), (block("python"), "example.py")):
        (work / name).write_text(text)
    program = str(home / "bin" / "lfmesh")
    for words in ("check scene.toml", "render scene.toml -o run --samples 16", "view run --html page.html"):
        run([program, *words.split()], work)
    run([inside, "example.py"], work)
    if not (work / "page.html").stat().st_size:
        raise SystemExit("tools/release: the page of lfmesh view --html is empty")
    return run([inside, "--version"], work).strip()


def block(language: str) -> str:
    """Return the README's block of code in a language."""
    (found,) = re.findall(rf"^```{language}\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)
    return str(found)


def run(words: list[str], folder: Path) -> str:
    """Run a command in a folder; end with what it said where it fails."""
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, env=alone)
    if done.returncode:
        print(f"tools/release: {' '.join(words)} failed\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}", file=sys.stderr)
        raise SystemExit(1)
    return done.stdout


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
