"""Which requests the page's server answers: tests/view/test_browser.py asks a running one."""

import asyncio
import logging

import pytest

pytest.importorskip("aiohttp", reason="the extra browser is not installed")

from aiohttp import web
from aiohttp.test_utils import make_mocked_request

from lfmesh.view.browser.guard import REFUSED, Guard, is_loopback, is_of_ours


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


@pytest.mark.parametrize(
    "request_head",
    [
        b"GET / HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: evil.example\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nno colon\r\n\r\n",
        b"GET /\xe9 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    ],
    ids=["no host", "two hosts", "no header", "no address"],
)
def test_a_request_that_is_no_http_is_refused_without_a_word_in_the_log(
    request_head: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    log = logging.getLogger("aiohttp.server")
    log.addFilter(is_of_ours)
    try:
        assert asyncio.run(_status(request_head)) in (400, 403)
    finally:
        log.removeFilter(is_of_ours)
    assert not caplog.records


def test_a_fault_of_the_servers_own_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    log = logging.getLogger("aiohttp.server")
    log.addFilter(is_of_ours)
    try:
        assert asyncio.run(_status(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", _fails)) == 500
    finally:
        log.removeFilter(is_of_ours)
    assert "a fault of ours" in caplog.text


@web.middleware
async def _fails(request: web.Request, handler: object) -> web.StreamResponse:
    raise RuntimeError("a fault of ours")


async def _status(head: bytes, middleware: object = None) -> int:
    """Return the status by which a server behind the guard, or another middleware, answers the bytes of a request."""
    runner = web.AppRunner(web.Application(middlewares=[middleware or Guard("127.0.0.1").answer]))
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0)
    await site.start()
    reader, writer = await asyncio.open_connection(*site._server.sockets[0].getsockname())
    writer.write(head)
    answer = await asyncio.wait_for(reader.readline(), 30.0)
    writer.close()
    await runner.cleanup()
    return int(answer.split()[1])
