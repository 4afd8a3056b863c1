"""Build the distributions of lfmesh, and try the wheel in an empty environment as a user would.

    tools/release --dry-run [PYTHON ...]

Builds into dist/. For each Python a new environment in a temporary folder gets the wheel by the README's `pip install`;
the README's commands and script run there, and `lfmesh view --html` writes a page. Needs the standard library alone.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"

BUILDER = "build>=1.2"
"""Program that builds both distributions, for pip."""

PIP = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
PAGE = "page.html"
MOST_NAMED = 5
"""Most missing files that a message names."""


class ReleaseError(Exception):
    """A fault of the release, in words."""


def main(pythons: list[str]) -> int:
    begun = time.perf_counter()
    try:
        version = stated_version(ROOT)
        say(f"version {version}, as in pyproject.toml, CITATION.cff and CHANGELOG.md")
        wheel = built()
        refuse_missing(wheel)
        say(f"{wheel.name} holds all files of lfmesh/ and assets/")
        for python in pythons or [sys.executable]:
            tried(python, wheel)
    except ReleaseError as fault:
        print(f"tools/release: {fault}", file=sys.stderr)
        return 1
    say(f"nothing was published; {DIST} holds the distributions; {time.perf_counter() - begun:.0f} s in all")
    return 0


def say(words: str) -> None:
    print(f"tools/release: {words}", flush=True)


def stated_version(root: Path) -> str:
    """Return the version, which three files must state alike.

    Raises
    ------
    ReleaseError
        They do not.
    """

    def read(name: str) -> str:
        return (root / name).read_text(encoding="utf-8")

    stated = {
        "pyproject.toml": str(tomllib.loads(read("pyproject.toml"))["project"]["version"]),
        "CITATION.cff": "".join(re.findall(r"^version: (\S+)$", read("CITATION.cff"), flags=re.MULTILINE)),
        "CHANGELOG.md": next(iter(re.findall(r"^## \[(\d[^\]]*)\]", read("CHANGELOG.md"), flags=re.MULTILINE)), ""),
    }
    if len(set(stated.values())) > 1:
        words = ", ".join(f"{version or 'none'} in {name}" for name, version in stated.items())
        raise ReleaseError(f"the files state several versions: {words}")
    return stated["pyproject.toml"]


def built() -> Path:
    """Build the wheel and the source distribution with a builder of their own; return the wheel."""
    shutil.rmtree(DIST, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix="lfmesh-build-") as folder:
        inside = environment(sys.executable, Path(folder) / "builder")
        run([inside, *PIP, BUILDER], Path(folder))
        run([inside, "-m", "build", "--outdir", str(DIST), str(ROOT)], ROOT)
    (wheel,) = DIST.glob("*.whl")
    return wheel


def refuse_missing(wheel: Path) -> None:
    """Refuse a wheel that lacks a file of the package or of the assets."""
    held = set(zipfile.ZipFile(wheel).namelist())
    if missing := sorted(set(wanted_in_wheel(ROOT)) - held):
        more = f" and {len(missing) - MOST_NAMED} more" if len(missing) > MOST_NAMED else ""
        raise ReleaseError(f"{wheel.name} lacks {', '.join(missing[:MOST_NAMED])}{more}")


def wanted_in_wheel(root: Path) -> Iterator[str]:
    """Yield the names that files of the package and the assets have in a wheel; git lists the files."""
    listed = run(["git", "ls-files", "-z", "lfmesh", "assets"], root, quiet=True)
    for name in filter(None, listed.split("\0")):
        yield name if name.startswith("lfmesh/") else f"lfmesh/{name}"


def environment(python: str, home: Path) -> str:
    """Make an empty environment; return its program."""
    run([python, "-m", "venv", str(home)], home.parent)
    return str(home / "bin" / "python")


def tried(python: str, wheel: Path) -> None:
    """Install the wheel for a Python into an empty environment, and do there what the README says."""
    begun = time.perf_counter()
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory(prefix="lfmesh-release-") as folder:
        work = Path(folder) / "work"
        work.mkdir()
        inside = environment(python, Path(folder) / "environment")
        version = run([inside, "--version"], work, quiet=True).strip()
        say(f"trial with {version} in an empty environment")
        (work / "scene.toml").write_text(block("toml", readme), encoding="utf-8")
        (work / "example.py").write_text(block("python", readme), encoding="utf-8")
        for words in steps(readme, wheel):
            # The environment's own programs, by their paths: it is not activated.
            run([str(Path(inside).parent / words[0]), *words[1:]], work)
        if not (work / PAGE).stat().st_size:
            raise ReleaseError("the page of lfmesh view --html is empty")
    say(f"{version}: {wheel.name} installs, renders and views; {time.perf_counter() - begun:.0f} s")


def steps(readme: str, wheel: Path) -> list[list[str]]:
    """Return the commands of a trial: those of the README, with the wheel in place of the checkout.

    Parameters
    ----------
    readme : str
        Its text.
    wheel : Path

    Raises
    ------
    ReleaseError
        The README names no installation by pip.
    """
    found = re.search(r"`(pip install [^`]*)`", readme)
    if found is None:
        raise ReleaseError("the README names no command `pip install` for a checkout")
    install = [re.sub(r"^\.(?=\[|$)", str(wheel), word) for word in shlex.split(found[1])]
    shell = "".join(re.findall(r"^```sh\n(.*?)^```$", readme, flags=re.MULTILINE | re.DOTALL))
    commands = [shlex.split(line) for line in shell.splitlines()]
    ours = [["lfmesh", *words[1:]] for words in commands if words[:1] == ["tools/run"]]
    return [install, *ours, ["python", "example.py"], ["lfmesh", "view", "run", "--html", PAGE]]


def block(language: str, readme: str) -> str:
    """Return the README's block of code in a language."""
    (found,) = re.findall(rf"^```{language}\n(.*?)^```$", readme, flags=re.MULTILINE | re.DOTALL)
    return str(found)


def run(words: list[str], folder: Path, *, quiet: bool = False) -> str:
    """Run a command in a folder and return its output.

    Parameters
    ----------
    words : list of str
    folder : Path
    quiet : bool
        Say nothing of it.

    Raises
    ------
    ReleaseError
        It fails; the message has the end of its output.
    """
    if not quiet:
        say(f"  {shlex.join([Path(words[0]).name, *words[1:]])}")
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    try:
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, env=alone)
    except OSError as error:
        raise ReleaseError(f"{words[0]} cannot be run: {error.strerror}") from None
    if done.returncode:
        raise ReleaseError(f"{shlex.join(words)} failed\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
