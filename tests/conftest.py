"""Markers: `long` tests run only with --long; `drawing` tests need GL libraries and `browser` tests Chromium, under CI
without excuse.
"""

import functools
import gc
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

# Before numpy is loaded, here and in the processes that tests start. Threads of OpenBLAS that wait for one another keep
# their processors busy, and the processes that run tests have none to spare: fits took twice the processor time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="also run long tests: slow ones, and further instances")
    parser.addoption("--random-scenes", metavar="FIRST:LAST", help="numbers of random cameras and scenes to examine")


COMPILE = """
import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.kernels.cache import is_cached
from lfmesh.transport.regions.objects import shade_objects
small = {"camera.sensor.pixels": [8, 8], "transport.samples": 4, "transport.replicates": 2}
if not is_cached(shade_objects):
    lf.render(lf.load(asset_path("scenes/first_light.toml")).changed(small))
"""


compiling = pytest.StashKey["subprocess.Popen[bytes]"]()


def pytest_sessionstart(session: pytest.Session) -> None:
    """Begin to compile what most tests need, once for all workers: each would compile it again."""
    workers = getattr(session.config.option, "numprocesses", None)
    if workers and not hasattr(session.config, "workerinput"):
        session.config.stash[compiling] = subprocess.Popen([sys.executable, "-c", COMPILE])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_node_collection_finished(node: Any) -> None:
    """Wait until that is compiled, before a worker that has collected the tests is given any."""
    if compiler := node.config.stash.get(compiling, None):
        compiler.wait()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect the tests without a search for garbage: what comes into being by it stays."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_sessionfinish(session: pytest.Session) -> None:
    if compiler := session.config.stash.get(compiling, None):
        compiler.kill()
        compiler.wait()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--long"):
        return
    by_length: dict[bool, list[pytest.Item]] = {True: [], False: []}
    for item in items:
        by_length[item.get_closest_marker("long") is not None].append(item)
    config.hook.pytest_deselected(items=by_length[True])
    items[:] = by_length[False]


@functools.cache
def drawing_fault() -> str | None:
    """Why nothing can be drawn off screen, or None. VTK crashes without GL, so a child process tries."""
    attempt = (
        "import pyvista\n"
        "plotter = pyvista.Plotter(off_screen=True, window_size=(16, 16))\n"
        "plotter.add_mesh(pyvista.Sphere())\n"
        "assert plotter.screenshot(return_img=True).any()\n"
    )
    child = subprocess.run([sys.executable, "-c", attempt], capture_output=True, text=True, timeout=600)
    if child.returncode == 0:
        return None
    return "drawing off screen does not work; install the packages libegl1 and libgl1-mesa-dri"


def chromium() -> str | None:
    """Return where the system's Chromium is, None if there is none."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next(filter(None, map(shutil.which, names)), None)


@functools.cache
def browser_fault() -> str | None:
    """Why no page can be tested in a browser, or None."""
    if importlib.util.find_spec("playwright") is None:
        return 'pages are tested with playwright: pip install "lfmesh[dev]"'
    return None if chromium() else "pages are tested in Chromium; install the package chromium"


def pytest_runtest_setup(item: pytest.Item) -> None:
    for marker, find_fault in (("drawing", drawing_fault), ("browser", browser_fault)):
        if item.get_closest_marker(marker) and (fault := find_fault()):
            if os.environ.get("CI") == "true":
                pytest.fail(f"{fault} (CI must be able to run tests marked {marker})", pytrace=False)
            pytest.skip(fault)
