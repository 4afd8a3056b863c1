"""A server without a network: it keeps the page's variables, and what answers each of its requests."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any


class State(SimpleNamespace):
    """The page's variables, as trame keeps them."""

    def __init__(self) -> None:
        super().__init__(side="paths", expression="", colour="wavelength", fade=False, cut=False, fault="")
        self.__dict__["said"] = []

    def update(self, values: dict[str, Any]) -> None:
        self.__dict__.update(values)

    def change(self, *_names: str) -> Callable[[Any], Any]:
        return lambda answer: answer

    def __setattr__(self, name: str, value: Any) -> None:
        self.__dict__["said"].append((name, value))
        self.__dict__[name] = value

    def __enter__(self) -> "State":
        return self

    def __exit__(self, *_: object) -> None:
        return None


class Server:
    """A server that keeps what answers a trigger, by its name."""

    def __init__(self) -> None:
        self.state, self.answers = State(), {}
        exists = SimpleNamespace(exists=lambda: False)
        self.controller = SimpleNamespace(trigger=self._trigger, redraw=exists)

    def _trigger(self, name: str) -> Callable[[Any], Any]:
        return lambda answer: self.answers.setdefault(name, answer)
