"""Pages that cannot be made are words, and the server goes on."""

from typing import Any

import pytest

from lfmesh.errors import LfmeshError
from lfmesh.view.browser.replies import OWN_MISTAKE

pytest.importorskip("trame_server")


FILE = "lens.toml: cannot be read"


@pytest.mark.parametrize(("fault", "words"), [(LfmeshError(FILE), FILE), (KeyError(1), OWN_MISTAKE)])
def test_a_later_page_that_fails_says_why(
    fault: Exception, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first one fails where the server is started; a later one must not end as an error 500."""
    from lfmesh.view.browser.sessions import Sessions

    class Empty:
        def close(self) -> None:
            pass

    made: list[Any] = []
    said: list[str] = []

    def fill(server: Any) -> Empty:
        made.append(server)
        if len(made) > 1:
            raise fault
        return Empty()

    def refuse(server: Any, words: str) -> None:
        said.append(words)

    sessions = Sessions(fill, refuse)
    failed = sessions._next()
    assert failed.shown is None
    assert said == [words]
    assert ("KeyError" in capsys.readouterr().err) == isinstance(fault, KeyError)
    with pytest.raises(type(fault)):
        Sessions(fill, refuse)
