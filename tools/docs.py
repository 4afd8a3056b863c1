"""Build the documentation site from assets/docs, the guides beside the code, the notebooks and the program itself.

    tools/docs [FOLDER] [--quick]

The pages and their files are copied into FOLDER/source as they lie in the project, so that links hold in both. The
program's own words (keys of files, commands, gallery, figures of the validation) are written beside them; some pages
get their Python names, pictures of warnings, or a figure that this build measured. Sphinx makes FOLDER/html of it. Any
warning fails, as does a broken link or a test of the validation. Renders, notebooks and figures are kept in FOLDER by
the digest of their input and of the program.
"""

import argparse
import hashlib
import json
import re
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from docs_accuracy import accuracy_picture
from docs_gallery import gallery, warned
from docs_links import broken_links
from docs_python import with_names
from docs_reference import commands_page, file_pages
from docs_validation import validation
from sphinx.cmd.build import main as sphinx

from lfmesh.provenance import program

ROOT = Path(__file__).resolve().parents[1]
PAGES = Path("assets/docs")
"""Of the site, in the project and in the copy."""

GUIDES = ["*.md", "lfmesh/**/*.md", "tests/**/README.md", "tools/README.md", "LICENSE", "CITATION.cff"]
ASSETS = ["docs", "notebooks", "pictures", "scenes", "designs", "lenses", "cameras"]
REDIRECT = '<!doctype html><meta http-equiv="refresh" content="0; url=assets/docs/index.html"><title>lfmesh</title>\n'


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="tools/docs", description="Build the documentation site.")
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "build" / "docs")
    parser.add_argument("--quick", action="store_true", help="leave out renders, notebooks and measurements")
    wanted = parser.parse_args(arguments)
    folder = wanted.folder.resolve()
    begun = time.perf_counter()
    valid = write_sources(folder, quick=wanted.quick)
    said = time.perf_counter() - begun
    code = sphinx(
        [
            *["-b", "html", "-W", "--keep-going", "-q", "-c", str(ROOT / PAGES)],
            *["-D", f"nb_execution_mode={'off' if wanted.quick else 'cache'}"],
            *["-D", f"nb_execution_cache_path={folder / 'notebooks' / program_digest()}"],
            *[str(folder / "source"), str(folder / "html")],
        ]
    )
    (folder / "html" / "index.html").write_text(REDIRECT, encoding="utf-8")
    broken = list(broken_links(folder / "html"))
    print(f"generated pages {said:.0f} s, all {time.perf_counter() - begun:.0f} s: {folder}/html/index.html")
    for fault in broken:
        print(f"broken link in {fault}", file=sys.stderr)
    if not valid:
        print("a test of the validation has failed: see its page", file=sys.stderr)
    return code if valid and not broken else 1


def write_sources(folder: Path, *, quick: bool) -> bool:
    """Write all pages for Sphinx; return whether the tests of the validation have passed."""
    program = program_digest()
    generated = folder / "source" / PAGES / "generated"
    pages = {**file_pages(), "commands": commands_page()}
    pages["gallery"], warns = gallery(folder / "renders", generated, program, quick=quick)
    pages["validation"], valid = validation(folder / "validation", program, quick=quick)
    for name, text in pages.items():
        keep(generated / f"{name}.md", text.encode())
    changed = {**python_pages(), **warning_pages(warns, folder / "source")}
    if (picture := accuracy_picture(folder / "accuracy", program, quick=quick)) is not None:
        changed[Path("assets/pictures/accuracy.png")] = picture.read_bytes()
    copy_sources(folder / "source", changed)
    return valid


def python_pages() -> dict[Path, bytes]:
    """Return the pages of the Python reference with their names."""
    texts = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in pages_in("python")}
    return {Path(name): text.encode() for name, text in with_names(texts).items()}


def warning_pages(warns: Mapping[str, Sequence[str]], place: Path) -> dict[Path, bytes]:
    """Return the pages of warnings with the pictures of scenes that warn.

    Parameters
    ----------
    warns : dict of sequence of str
        Names of scenes, by kind of warning.
    place : Path
        Folder of the copy.
    """
    pages = {}
    for path in pages_in("warnings"):
        own = path.relative_to(ROOT)
        text = path.read_text(encoding="utf-8") + warned(
            warns.get(path.stem, ()), place / PAGES / "generated", place / own
        )
        pages[own] = text.encode()
    return pages


def pages_in(folder: str) -> list[Path]:
    """Return the pages in a folder of the site's pages."""
    return sorted((ROOT / PAGES / folder).glob("*.md"))


def copy_sources(place: Path, changed: Mapping[Path, bytes]) -> None:
    """Copy the pages, the guides and their files; a file that has not changed stays.

    Parameters
    ----------
    place : Path
        Folder of the copy.
    changed : dict of bytes
        Content in place of a file's own, by its path in the project.
    """
    sources = {path for pattern in GUIDES for path in ROOT.glob(pattern)}
    sources |= {path for name in ASSETS for path in (ROOT / "assets" / name).rglob("*") if path.is_file()}
    wanted = {path.relative_to(ROOT) for path in sources if path.suffix not in (".py", ".pyc")}
    # Code that guides link to is offered for download.
    wanted |= {path.relative_to(ROOT) for guide in sources if guide.suffix == ".md" for path in linked_code(guide)}
    for path in [path for path in place.rglob("*") if path.is_file()]:
        if path.relative_to(place) not in wanted and "generated" not in path.parts:
            path.unlink()
    for path in wanted:
        keep(place / path, changed[path] if path in changed else (ROOT / path).read_bytes())


def linked_code(guide: Path) -> Iterator[Path]:
    """Yield the files of code that a guide links to."""
    for link in re.findall(r"\]\(([^)#:]+\.py)\)", guide.read_text(encoding="utf-8")):
        yield (guide.parent / link).resolve()


def keep(path: Path, content: bytes) -> None:
    """Write a file, unless it holds that already: Sphinx reads again what is newer."""
    if path.is_file() and path.read_bytes() == content:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def program_digest() -> str:
    """Return a short name for the program whose renders are kept."""
    return hashlib.sha256(json.dumps(program(), sort_keys=True).encode()).hexdigest()[:12]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
