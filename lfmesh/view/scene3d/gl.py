"""Test for drawing: VTK ends the process if the GL libraries are missing, so a child process tries first."""

import os
import subprocess
import sys

from lfmesh.errors import LfmeshError

SECONDS = 60

WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"
"""Environment variable for the kind of window that VTK opens."""

ATTEMPT = (
    "import vtkmodules.vtkRenderingOpenGL2\n"
    "from vtkmodules.vtkRenderingCore import vtkRenderWindow\n"
    "window = vtkRenderWindow()\n"
    "window.SetOffScreenRendering(1)\n"
    "window.SetSize(8, 8)\n"
    "window.Render()\n"
    "assert window.SupportsOpenGL()\n"
)

MISSING = "drawing needs the GL libraries: install the packages libegl1 and libgl1-mesa-dri (Debian and Ubuntu)"


class Probe:
    """Attempt to draw in the background while the scene is built."""

    def __init__(self) -> None:
        expect_no_display()
        self._child = subprocess.Popen(
            [sys.executable, "-c", ATTEMPT],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def check(self) -> None:
        """Wait for the end of the attempt.

        Raises
        ------
        LfmeshError
            The libraries are missing.
        """
        try:
            code = self._child.wait(SECONDS)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
            code = -1
        if code != 0:
            raise LfmeshError(MISSING)

    def __enter__(self) -> "Probe":
        return self

    def __exit__(self, *_: object) -> None:
        if self._child.poll() is None:
            self._child.kill()
        self._child.wait()


def expect_no_display() -> None:
    """Keep VTK from seeking a missing display and complaining."""
    if sys.platform == "linux" and not has_display():
        os.environ.setdefault(WINDOW, "vtkEGLRenderWindow")


def has_display() -> bool:
    """Tell whether a window can open."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
