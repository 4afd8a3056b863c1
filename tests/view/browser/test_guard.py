"""Which requests the page's server answers: tests/view/test_browser.py asks a running one."""

import pytest

pytest.importorskip("aiohttp", reason="the extra browser is not installed")

from aiohttp.test_utils import make_mocked_request

from lfmesh.view.browser.guard import REFUSED, Guard, is_loopback


def fault(guard: Guard, host: str, origin: str | None = None, token: str | None = None) -> str | None:
    headers = {"Host": host} | ({"Origin": origin} if origin is not None else {})
    if token is not None:
        headers["Cookie"] = f"lfmesh-{host.rsplit(':', 1)[-1]}={token}"
    return guard.fault(make_mocked_request("GET", "/ws", headers=headers))


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "localhost:8000", "[::1]:8000"])
def test_this_machine_is_answered_by_all_its_names(host: str) -> None:
    guard = Guard("127.0.0.1")
    assert fault(guard, host, f"http://{host}", guard.token) is None
    assert fault(guard, host, None, guard.token) is None


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("evil.example:8000", None),
        ("evil.example:8000", "http://evil.example:8000"),
        ("127.0.0.1.evil.example:8000", None),
        ("localhost.evil.example", None),
        ("192.168.1.7:8000", None),
        ("127.0.0.1:8000", "http://evil.example"),
        ("127.0.0.1:8000", "http://127.0.0.1:9999"),
        ("127.0.0.1:8000", "http://127.0.0.1:8000.evil.example"),
        ("127.0.0.1:8000", "null"),
        ("127.0.0.1:8000", ""),
    ],
)
def test_strangers_are_refused_even_with_the_token(host: str, origin: str | None) -> None:
    guard = Guard("127.0.0.1")
    assert (fault(guard, host, origin, guard.token) or "").startswith(REFUSED)


def test_bound_elsewhere_the_token_and_the_origin_still_decide() -> None:
    guard = Guard("0.0.0.0")
    host = "lab.example:8000"
    assert fault(guard, host, f"http://{host}", guard.token) is None
    assert fault(guard, host, f"http://{host}") is not None
    assert fault(guard, host, "http://evil.example", guard.token) is not None


def test_tokens_differ_and_are_long() -> None:
    tokens = {Guard("127.0.0.1").token for _ in range(50)}
    assert len(tokens) == 50
    assert min(map(len, tokens)) >= 32


def test_loopback_is_known_by_its_addresses() -> None:
    assert all(map(is_loopback, ["127.0.0.1", "127.9.9.9", "::1", "[::1]", "localhost"]))
    assert not any(map(is_loopback, ["0.0.0.0", "::", "192.168.1.7", "lab.example"]))
