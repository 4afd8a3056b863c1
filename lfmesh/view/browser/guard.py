"""Access to the page: for the browser that was given its address, and no page of any other site.

A server on loopback is reachable by every site that the same browser shows: through a websocket, which browsers open
across origins, and through a domain name that is pointed at 127.0.0.1 after its page was loaded (DNS rebinding); and by
everybody else on a shared machine. So `Host` and `Origin` must be ours, and a browser must have been let in by the
token in the address that was printed, which it keeps as a cookie.
"""

import hmac
import ipaddress
import logging
import re
import secrets
from collections.abc import Awaitable, Callable

from aiohttp import hdrs, web
from aiohttp.http_exceptions import HttpProcessingError

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

LOOPBACK_NAMES = ("127.0.0.1", "localhost", "[::1]")

_ADDRESS = re.compile(r"(?P<name>\[[0-9A-Fa-f:.]+\]|[0-9A-Za-z._-]+)(:[0-9]{1,5})?")
"""A `Host`: a name or an address, and a port."""

REFUSED = "lfmesh refuses this request"
"""Beginning of every refusal."""


def is_loopback(host: str) -> bool:
    """Tell whether an address can be reached from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def is_of_ours(record: logging.LogRecord) -> bool:
    """Tell whether a record of aiohttp's log is about this program: a filter of its logger.

    A request that is no HTTP, such as one without `Host` or with two, never reaches `Guard`. aiohttp answers it by 400,
    and would log it with a traceback as if a fault of the server's had come to light.
    """
    return record.exc_info is None or not isinstance(record.exc_info[1], HttpProcessingError)


class Guard:
    """Refuses every request that does not come from a page that this server made.

    Parameters
    ----------
    host : str
        The address that the server is bound to. On loopback the `Host` of a request must name this machine; elsewhere
        the names of the machine are not known here, and the token alone keeps others out.
    """

    def __init__(self, host: str) -> None:
        self._loopback = is_loopback(host)
        self.token = secrets.token_urlsafe(24)

    def fault(self, request: web.Request) -> str | None:
        """Say why a request is refused; None if it is not."""
        if (name := _name_of_odd_header(request)) is not None:
            return f"{REFUSED}: its header {name} is not ASCII"
        host = request.host
        address = _ADDRESS.fullmatch(host)
        if address is None or (self._loopback and address["name"] not in LOOPBACK_NAMES):
            return f"{REFUSED}: it asks for the host {host}, which is not this machine"
        origin = request.headers.get(hdrs.ORIGIN)
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return f"{REFUSED}: it comes from a page of {origin}"
        if not self._admitted(request):
            return f"{REFUSED}: open the whole address that lfmesh printed, with its token"
        return None

    @web.middleware
    async def answer(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Answer a request, or refuse it: a middleware of aiohttp."""
        if fault := self.fault(request):
            return web.Response(status=403, text=fault + "\n")
        if self._same(request.query.get("token")):
            return self._admit(request)
        try:
            response = await handler(request)
        except ConnectionResetError:
            # The browser left in the middle of an answer: nobody is there to be told.
            return web.Response()
        if not response.prepared:
            response.headers.update(_headers(request.host))
        return response

    def _admitted(self, request: web.Request) -> bool:
        return self._same(request.cookies.get(_cookie(request.host))) or self._same(request.query.get("token"))

    def _same(self, token: str | None) -> bool:
        # aiohttp decodes bytes of a header that are no UTF-8 as surrogates.
        return token is not None and hmac.compare_digest(token.encode(errors="surrogatepass"), self.token.encode())

    def _admit(self, request: web.Request) -> web.StreamResponse:
        """Let a browser keep the token, and take it out of the address, which others may see over a shoulder."""
        response = web.HTTPFound("/index.html")
        response.set_cookie(_cookie(request.host), self.token, httponly=True, samesite="Strict")
        return response


def _name_of_odd_header(request: web.Request) -> str | None:
    """Return the name of a header that no browser sends: one that is not ASCII, but for cookies, which others set."""
    odd = (name for name, value in request.headers.items() if not value.isascii() and name.title() != hdrs.COOKIE)
    return next(odd, None)


def _cookie(host: str) -> str:
    """Cookies are kept by name, not by port: two pages on one machine must not take each other's."""
    return f"lfmesh-{host.rsplit(':', 1)[-1]}"


def _headers(host: str) -> dict[str, str]:
    """Headers by which the browser itself lets nothing of the page leave for another host.

    Vue compiles the page's template in the browser, which needs 'unsafe-eval'.
    """
    policy = (
        "default-src 'self'",
        "script-src 'self' 'unsafe-inline' 'unsafe-eval'",
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data: blob:",
        f"connect-src 'self' ws://{host}",
        "frame-ancestors 'none'",
    )
    return {
        "Content-Security-Policy": "; ".join(policy),
        "Cross-Origin-Resource-Policy": "same-origin",
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
    }
