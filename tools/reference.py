"""Reference renders of this tree against those of another: which bits of the pictures a change alters.

    tools/reference HEAD~1                    another commit, checked out beside for the time
    tools/reference ../other-checkout         another checkout, with the kernels that it has compiled already
    tools/reference --save before.json        no comparison: the digests of this tree, to compare with later
    tools/reference before.json --only fog

Of some 40 scenes a few pixels are rendered with a few samples each, on one thread: arrays of all kinds, covers, ghosts,
media, glass, particles, lamps, rough surfaces, polarised light, bands, both methods and both engines. The means, the
errors, the upper bounds and the ledgers, with the energy lost, are compared by digests of their float64 numbers.
Digests hold on one machine only, so none are kept in the repository.

This command serves the redesign of `transport/` alone, and is removed with it.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from bench_against import ROOT, checked_out

import lfmesh as lf
from lfmesh.assets import asset_path

SMALL = {"camera.sensor.pixels": [10, 8], "transport.samples": 8, "transport.replicates": 2, "transport.threads": 1}
FEW_SAMPLES = {"transport.samples": 8, "transport.replicates": 2}

COMPARED = ("mean", "error", "upper", "ledger")
Digests = dict[str, str]

CHANGES: dict[str, dict[str, Any]] = {
    "particles": {"particles[0].count": 200, "particles[0].samples": 16},
    "lytro_class": {"camera.mla.count": [41, 34]},
}
"""Changes of scenes of the assets, beside those of all, so that they take less time."""

VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "forward": ("first_light", {"transport.method": "forward"}),
    "forward through fog": ("fog", {"transport.method": "forward"}),
    "by meshes alone": ("first_light", {"transport.engine": "mesh", "transport.split": "transmit"}),
    "by patches": ("first_light", {"transport.surface": "patch"}),
    "one child by chance": ("emitting_plane", {"transport.split": "roulette"}),
    "adaptive": ("lit_chart", {"transport.target_error": 0.2, "transport.max_samples": 32}),
    "lens of a mesh": (
        "conventional",
        {
            "camera.lens": {
                "surfaces": [
                    {"stop": True, "thickness_mm": 1.0, "semi_diameter_mm": 4.0},
                    {
                        "refractor": {"file": "../meshes/ball.ply", "units": "mm", "index": 1.5},
                        "semi_diameter_mm": 10.0,
                    },
                ]
            }
        },
    ),
    "paraxial lens": (
        "conventional",
        {"camera.lens": {"surfaces": [{"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 6.0}]}},
    ),
}
"""Scenes of the assets with other settings: the asset, and the changes."""

DRAWN = {"camera": (2, 4, 19, 21, 25, 26), "scene": (3, 7, 13, 17, 23, 28)}
"""Numbers of scenes of `tests/random_scenes`: coatings that absorb, rough faces, cylindrical and posed arrays, lenslets
on both faces, a sensor that reflects, glass with fog, temperatures, metal, particles, a tank."""


def say(text: str) -> None:
    print(f"tools/reference: {text}", file=sys.stderr, flush=True)


class OneLineParser(argparse.ArgumentParser):
    """A parser that says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        """End with the message."""
        self.exit(2, f"tools/reference: {message}; --help says more\n")


def cases() -> dict[str, Callable[[], lf.Scene]]:
    """Return the makers of some 40 scenes by their names."""

    def asset(name: str, changes: dict[str, Any]) -> Callable[[], lf.Scene]:
        return lambda: lf.load(asset_path(f"scenes/{name}.toml")).changed(SMALL | changes)

    def drawn(kind: Any, number: int) -> Callable[[], lf.Scene]:
        def make() -> lf.Scene:
            sys.path.insert(0, str(ROOT))
            from tests.random_scenes.generator import draw

            return draw(kind, number).scene.changed(FEW_SAMPLES)

        return make

    names = [path.stem for path in sorted(asset_path("scenes").glob("*.toml"))]
    made = {name: asset(name, CHANGES.get(name, {})) for name in names}
    made |= {name: asset(*variant) for name, variant in VARIANTS.items()}
    return made | {f"{kind} {number}": drawn(kind, number) for kind in DRAWN for number in DRAWN[kind]}


def requests(names: Iterable[str]) -> Iterator[dict[str, Any]]:
    """Yield each scene as tables, with the folder that its paths start from."""
    makers = cases()
    for name in names:
        scene = makers[name]()
        folder = asset_path("." if name.startswith(tuple(DRAWN)) else "scenes")
        yield {"name": name, "tables": json.loads(scene.to_json()), "folder": str(folder.resolve())}


def render_on_demand() -> None:
    """Render the scene of each line of the input, and answer with the digests and the seconds that it took."""
    for line in sys.stdin:
        asked = json.loads(line)
        began = time.process_time()
        try:
            found = digests_of(lf.render(lf.Scene(**asked["tables"]).in_folder(asked["folder"])))
        except lf.LfmeshError as error:
            found = dict.fromkeys(COMPARED, str(error))
        print(json.dumps([found, time.process_time() - began]), flush=True)


def digests_of(image: Any) -> Digests:
    """Return a digest of each array that is compared."""
    energies = [*numbers(image.ledger.as_dict())]
    found = {"mean": image.mean, "error": image.error, "upper": image.upper, "ledger": energies}
    return {name: digest(array) for name, array in found.items()}


def numbers(value: Any) -> Iterator[float]:
    """Yield the numbers of a ledger, in the order of their names."""
    if isinstance(value, dict):
        for _, each in sorted(value.items()):
            yield from numbers(each)
    elif isinstance(value, int | float):
        yield float(value)


def digest(array: Any) -> str:
    """Return a digest of an array's float64 numbers, bit by bit, and of its shape."""
    numbers = np.ascontiguousarray(array, np.float64)
    return hashlib.sha256(repr(numbers.shape).encode() + numbers.tobytes()).hexdigest()[:16]


def rendered(tree: Path, names: Iterable[str]) -> dict[str, Digests]:
    """Render the scenes with the lfmesh of a folder, in a process of its own."""
    paths = [str(tree), os.environ.get("PYTHONPATH", "")]
    found = {}
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", __file__, "--case"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))},
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        for request in requests(names):
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            answer = process.stdout.readline()
            if not answer:
                sys.exit(f"tools/reference: {request['name']}: the process that renders ended; see above")
            found[request["name"]], seconds = json.loads(answer)
            say(f"{request['name']}: {seconds:.1f} s")
        process.stdin.close()
    return found


@contextmanager
def digests_of_other(against: str, names: list[str]) -> Iterator[dict[str, Digests]]:
    """Render with another checkout or commit, or read what was saved."""
    path = Path(against)
    if path.is_file():
        yield json.loads(path.read_text(encoding="utf-8"))
    elif path.is_dir():
        yield rendered(path.resolve(), names)
    else:
        with checked_out(against) as tree:
            yield rendered(tree, names)


def differences(here: dict[str, Digests], there: dict[str, Digests]) -> dict[str, list[str]]:
    """Return what differs in each scene, where anything does; a scene that the other has not is not compared."""
    found = {name: [what for what in COMPARED if here[name][what] != there[name][what]] for name in here.keys() & there}
    return {name: found[name] for name in here if found.get(name)}


def main() -> int:
    parser = OneLineParser("tools/reference", description="Bits of some 40 reference renders of two trees.")
    parser.add_argument("against", nargs="?", help="a commit, the folder of another checkout, or a file of --save")
    parser.add_argument("--save", type=Path, metavar="FILE", help="write the digests of this tree as JSON")
    parser.add_argument("--only", metavar="WORD", default="", help="scenes whose names hold the word")
    parser.add_argument("--case", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.case:
        render_on_demand()
        return 0
    names = [name for name in cases() if given.only in name]
    if not names:
        parser.error(f'no scene has "{given.only}" in its name')
    if given.against is None and given.save is None:
        parser.error("name what to compare with, or a file to save the digests")
    here = rendered(ROOT, names)
    if given.save is not None:
        given.save.write_text(json.dumps(here, indent=2) + "\n", encoding="utf-8")
    if given.against is None:
        return 0
    try:
        with digests_of_other(given.against, names) as there:
            found = differences(here, there)
    except lf.LfmeshError as error:
        parser.error(str(error))
    for name, what in found.items():
        print(f"{name}: {', '.join(what)}")
    compared = len(here.keys() & there)
    print(f"{compared - len(found)} of {compared} reference renders have the bits of {given.against}")
    return 1 if found or not compared else 0


if __name__ == "__main__":
    sys.exit(main())
