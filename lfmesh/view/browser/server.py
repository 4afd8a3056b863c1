"""Start and stop of the page's server: its address, output and shutdown."""

import asyncio
import errno
import logging
import os
import signal
import socket
import sys
import webbrowser
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from lfmesh.errors import LfmeshError
from lfmesh.view.scene3d.gl import Probe, has_display

if TYPE_CHECKING:
    from lfmesh.scene import Scene
    from lfmesh.transport.render.image import Image
    from lfmesh.transport.world import World
    from lfmesh.view.browser.sessions import Sessions
    from lfmesh.view.rays.paths import Rays
    from lfmesh.view.scene3d.colours import ColourBy

EXTRA = 'the page in the browser needs more packages: pip install "lfmesh[browser]"'


def serve(
    subject: "Scene | World | Image | str | os.PathLike[str]",
    rays: "Rays | None" = None,
    *,
    expression: str = "",
    colour: "ColourBy | None" = None,
    fade: bool = False,
    preset: str = "whole",
    cut: bool = False,
    host: str = "127.0.0.1",
    port: int = 0,
    open_browser: bool = True,
) -> None:
    """Serve the viewer as a web page until Ctrl-C.

    Prints the page's address, which includes the access token. Each tab has its own state, see
    `lfmesh.view.browser.sessions`.

    Parameters
    ----------
    subject : Scene, World, Image, or path of a scene file or a run folder
        Scene or run to view; a run folder includes its image and light field.
    rays : Rays, optional
        Initial rays, launched in the subject's world.
    expression : str
        Initial content of the filter box, see `lfmesh.view.rays.filters`.
    colour : {"wavelength", "power", "events", "status", "path", "field"}, optional
    fade : bool
        Draw weaker rays fainter.
    preset : {"whole", "side", "object", "lens", "array", "sensor"}
    cut : bool
        Cut lens and array along the axis.
    host : str
        Address to bind to; anything but loopback serves other machines, too.
    port : int
        0: any free port.
    open_browser : bool
        Open the page in the user's browser if there is a display.

    Raises
    ------
    LfmeshError
        The port is taken, the host is not an address of this machine, the extra `browser` is missing, nothing can be
        drawn here, or the subject cannot be read.
    """
    refuse_to_serve(host, port)
    import trame_server

    with Probe() as probe:
        from lfmesh.view.browser.guard import Guard, is_loopback, is_of_ours
        from lfmesh.view.browser.page import Page, say
        from lfmesh.view.browser.sessions import Sessions
        from lfmesh.view.browser.subject import PageSubject

        probe.check()
    if not is_loopback(host):
        _warn_of_others(host)
    # trame reads options from sys.argv, some of which have the names of ours.
    os.environ.setdefault("TRAME_ARGS", "")
    read = PageSubject.read(subject, rays)
    fill = partial(Page, subject=read, expression=expression, colour=colour, fade=fade, preset=preset, cut=cut)
    sessions = Sessions(fill, say)
    # It sends files, and passes websockets to the sessions.
    server = trame_server.Server("lfmesh")
    server.client_type = "vue3"
    sessions.add_files(server)
    guard = Guard(host)
    logging.getLogger("aiohttp.server").addFilter(is_of_ours)
    server.controller.on_server_bind.add(lambda site: site.app.middlewares.extend([guard.answer, sessions.answer]))
    asyncio.run(_serve(server, sessions, guard.token, host, port, open_browser))


def refuse_to_serve(host: str, port: int) -> None:
    """Refuse a page that cannot be served, before anything is built or traced for it.

    Parameters
    ----------
    host : str
    port : int
        0: any free port.

    Raises
    ------
    LfmeshError
        The port is taken, the host is not an address of this machine, or the extra `browser` is missing.
    """
    if not 0 <= port <= 65535:
        raise LfmeshError(f"port = {port}: must be from 1 to 65535, or 0 for any free port")
    try:
        import aiohttp  # noqa: F401
        import trame_server  # noqa: F401
        import trame_vtk  # noqa: F401
    except ImportError as missing:
        raise LfmeshError(f"{EXTRA} ({missing.name} is missing)") from None
    if _is_in_event_loop():
        raise LfmeshError("the page is served from the command line or a script; in a notebook use lf.show")
    _refuse_taken(host, port)


async def _serve(server: Any, sessions: "Sessions", token: str, host: str, port: int, open_browser: bool) -> None:
    """Run the server until it is interrupted or fails.

    Parameters
    ----------
    server : trame_server.Server
    sessions : Sessions
    token, host, port, open_browser
        As for `serve`.
    """
    # Browsers disconnect during answers when a page is closed; `Replies` reports our own faults.
    logging.getLogger("wslink").setLevel(logging.CRITICAL)
    loop, end = asyncio.get_running_loop(), asyncio.Event()
    loop.set_exception_handler(_report)
    for number in (signal.SIGINT, signal.SIGTERM):
        # Unavailable on Windows, where Ctrl-C still raises KeyboardInterrupt.
        with suppress(NotImplementedError, RuntimeError, ValueError):
            loop.add_signal_handler(number, end.set)

    def ready(**_state: Any) -> None:
        address = f"http://{_in_address(host)}:{server.port}/?token={token}"
        print(f"lfmesh: {address}  (Ctrl-C ends it)", flush=True)
        if open_browser and has_display():
            webbrowser.open(address)

    server.controller.on_server_ready.add(ready)
    serving = asyncio.ensure_future(
        server.start(
            exec_mode="coroutine", host=host, port=port, timeout=0, thread=True, backend="aiohttp",
            open_browser=False, show_connection_info=False, disable_logging=True,
        )
    )  # fmt: skip
    ended = asyncio.ensure_future(end.wait())
    await asyncio.wait({serving, ended}, return_when=asyncio.FIRST_COMPLETED)
    await sessions.close()
    if ended.done():
        await server.stop()
    ended.cancel()
    try:
        await serving
    except OSError as fault:
        raise _cannot_bind(fault, host, port) from None


def _report(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report faults outside of answers, except for pages closed during a transmission."""
    if not isinstance(context.get("exception"), ConnectionResetError):
        loop.default_exception_handler(context)


def _is_in_event_loop() -> bool:
    """Tell whether an event loop made this call, as always in notebooks."""
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return False
    return True


def _refuse_taken(host: str, port: int) -> None:
    """Refuse an address that cannot be bound, before the scene is built."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_STREAM) as attempt:
            if os.name == "posix":
                attempt.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            attempt.bind((host, port))
    except OSError as fault:
        raise _cannot_bind(fault, host, port) from None


def _cannot_bind(fault: OSError, host: str, port: int) -> LfmeshError:
    if fault.errno == errno.EADDRINUSE:
        return LfmeshError(f"port = {port}: another program listens there; choose another, or 0 for any free port")
    if fault.errno in (errno.EACCES, errno.EPERM):
        return LfmeshError(f"port = {port}: may not be used by this user; choose one above 1023, or 0")
    return LfmeshError(f"host = {host}: is not an address of this machine; omit it to serve this machine only")


def _in_address(host: str) -> str:
    """Return the host's name for a browser on this machine."""
    if host in ("0.0.0.0", "::"):
        return "127.0.0.1"
    return f"[{host}]" if ":" in host else host


def _warn_of_others(host: str) -> None:
    print(
        f"lfmesh: host = {host} lets other machines reach the page. Anyone who has its address with the token sees all "
        "of it, and the connection is not encrypted.",
        file=sys.stderr,
    )
