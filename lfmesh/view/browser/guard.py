"""Access control of the page: only for the browser that was given its address, and no page of another site.

Every site open in the same browser can reach a server on loopback, through a websocket (browsers open these across
origins) or a domain name redirected to 127.0.0.1 after its page was loaded (DNS rebinding); on a shared machine, so can
everybody. So `Host` and `Origin` must match, and the browser must hold the token from the printed address as a cookie.
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
"""A `Host` header: name or address, and port."""

REFUSED = "lfmesh refuses this request"
"""Start of every refusal."""


def is_loopback(host: str) -> bool:
    """Tell whether an address can be reached only from this machine."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def is_of_ours(record: logging.LogRecord) -> bool:
    """Tell whether a record of aiohttp's log concerns this program, as a logging filter.

    Requests that are not valid HTTP, such as ones with no `Host` or two, never reach `Guard`. aiohttp answers them with
    400, and would log them with a traceback like a fault of the server.
    """
    return record.exc_info is None or not isinstance(record.exc_info[1], HttpProcessingError)


class Guard:
    """Guard against requests from other pages than this server's.

    Parameters
    ----------
    host : str
        Address of the server. On loopback the `Host` of a request must name this machine. Otherwise the machine's names
        are unknown here, and only the token protects the page.
    """

    def __init__(self, host: str) -> None:
        self._loopback = is_loopback(host)
        self.token = secrets.token_urlsafe(24)

    def fault(self, request: web.Request) -> str | None:
        """Return the reason to refuse a request, or None."""
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
        """Answer or refuse a request, as aiohttp middleware."""
        if fault := self.fault(request):
            return web.Response(status=403, text=fault + "\n")
        if self._same(request.query.get("token")):
            return self._admit(request)
        try:
            response = await handler(request)
        except ConnectionResetError:
            # The browser disconnected during the answer: nobody needs to be told.
            return web.Response()
        if not response.prepared:
            response.headers.update(_headers(request.host))
        return response

    def _admitted(self, request: web.Request) -> bool:
        return self._same(request.cookies.get(_cookie(request.host))) or self._same(request.query.get("token"))

    def _same(self, token: str | None) -> bool:
        # aiohttp decodes header bytes outside UTF-8 as surrogates.
        return token is not None and hmac.compare_digest(token.encode(errors="surrogatepass"), self.token.encode())

    def _admit(self, request: web.Request) -> web.StreamResponse:
        """Store the token in the browser's cookies, and remove it from the address, which others may see."""
        response = web.HTTPFound("/index.html")
        response.set_cookie(_cookie(request.host), self.token, httponly=True, samesite="Strict")
        return response


def _name_of_odd_header(request: web.Request) -> str | None:
    """Return the name of a non-ASCII header other than the cookie; browsers send none."""
    odd = (name for name, value in request.headers.items() if not value.isascii() and name.title() != hdrs.COOKIE)
    return next(odd, None)


def _cookie(host: str) -> str:
    """Return a cookie name with the port: cookies are stored by name only, and two pages must not share one."""
    return f"lfmesh-{host.rsplit(':', 1)[-1]}"


def _headers(host: str) -> dict[str, str]:
    """Return headers that keep the browser from sending anything of the page to another host.

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
