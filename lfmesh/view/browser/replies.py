"""Answers to the page: user mistakes are shown in it, and only the latest request is processed."""

import asyncio
import functools
import traceback
from collections.abc import Callable
from typing import Any

from lfmesh.errors import LfmeshError

OWN_MISTAKE = "Internal error of lfmesh; the terminal has the details."


class Replies:
    """Connection of methods to the page's requests.

    Parameters
    ----------
    server : trame_server.Server
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._wishes: dict[str, tuple[Any, ...]] = {}

    def on_call(self, name: str, answer: Callable[..., Any]) -> None:
        """Answer the page's ``trigger(name, [arguments])``."""
        self._server.controller.trigger(name)(self._with_messages(answer))

    def on_latest(self, name: str, answer: Callable[..., Any]) -> None:
        """Answer like `on_call`, but only the last of calls that arrive faster than answers: mouse moves, sliders."""
        safe = self._with_messages(answer)

        async def work() -> None:
            # Let other messages that arrived with this call be read first.
            await asyncio.sleep(0.0)
            with self._server.state:
                safe(*self._wishes.pop(name))

        def wish(*arguments: Any) -> None:
            waiting = name in self._wishes
            self._wishes[name] = arguments
            if not waiting:
                asyncio.ensure_future(work())  # noqa: RUF006 - done before the loop is, or not needed any more

        self._server.controller.trigger(name)(wish)

    def on_change(self, names: list[str], answer: Callable[[], Any]) -> None:
        """Answer when the user or the program changes one of these page variables."""
        safe = self._with_messages(answer)
        self._server.state.change(*names)(lambda **_state: safe())

    def _with_messages(self, answer: Callable[..., Any]) -> Callable[..., Any]:
        """Return an answer that shows its mistakes in the page."""

        @functools.wraps(answer)
        def safe(*arguments: Any) -> Any:
            self._server.state.fault = ""
            return self.attempt(answer, *arguments)

        return safe

    def attempt(self, answer: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function and return its result; if it fails, show why in the page and return None."""
        try:
            return answer(*arguments)
        except Exception as fault:
            self.show(fault)
            return None

    def show(self, fault: Exception) -> None:
        """Show a user's mistake in the page; details of an internal error go to the terminal."""
        if isinstance(fault, LfmeshError):
            self._server.state.fault = str(fault)
        else:
            self._server.state.fault = OWN_MISTAKE
            traceback.print_exception(fault)
