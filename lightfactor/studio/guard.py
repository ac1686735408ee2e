"""Who may ask the workbench for what: only pages that it served itself, on this machine, to who started it.

Any web page that a browser shows can send requests to this machine. What it can't do is read the token, which is made
at each launch and stands behind the # of the address, where no server or log sees it; nor set a header of its own
without being asked first, which is always answered with a refusal; nor pass under another name for this machine.
"""

from __future__ import annotations

import hmac
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

TOKEN_HEADER = "x-lightfactor-token"
# What is asked for with a token; all else is the page itself, the same for everyone.
GUARDED = "/api/"
_NAMES = ("127.0.0.1", "localhost")
# Bytes of a request: of commands, and of pictures, which are maps of light and masks.
_MOST_BYTES, _MOST_PICTURE_BYTES = 1 << 20, 64 << 20
_PICTURES = ("/lights", "/mask")
_TOO_LARGE = "the request is too large"
_POLICY = {
    "content-security-policy": "default-src 'self'; img-src 'self' blob: data:; base-uri 'none'; form-action 'none';"
    " frame-ancestors 'none'; object-src 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


class Guard:
    """Refuses what doesn't come from the workbench's own page, before anything reads it."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app = app
        self._token = token.encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """An ASGI application; only HTTP is served."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return
        refused = self._refusal(scope)

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_POLICY)
            await send(message)

        if refused is not None:
            status, why = refused
            await PlainTextResponse(why + "\n", status)(scope, receive, sent)
            return
        await self._app(scope, _Limited(receive, _most_bytes(scope["path"])), sent)

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Status and reason where a request is refused."""
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if len(headers.getlist("host")) != 1 or _host_name(host) not in _NAMES:
            return 421, "only 127.0.0.1 and localhost are served"
        origin = headers.get("origin")
        if origin is not None and origin != f"http://{host}":
            return 403, "the request comes from another page"
        if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            return 403, "the request comes from another page"
        if scope["path"].startswith(GUARDED):
            given = headers.get(TOKEN_HEADER, "").encode()
            if not hmac.compare_digest(given, self._token):
                return 403, "the token is missing or another launch's: open the address that was printed"
        elif scope["method"] not in ("GET", "HEAD"):
            return 405, "the page is only read"
        length = headers.get("content-length", "0")
        if not length.isdigit() or int(length) > _most_bytes(scope["path"]):
            return 413, _TOO_LARGE
        return None


class _Limited:
    """Receives a body as long as it stays below a size, whatever its length was said to be."""

    def __init__(self, receive: Receive, most: int) -> None:
        self._receive = receive
        self._left = most

    async def __call__(self) -> Message:
        message = await self._receive()
        self._left -= len(message.get("body", b""))
        if self._left < 0:
            raise HTTPException(413, _TOO_LARGE)
        return message


def _most_bytes(path: str) -> int:
    return _MOST_PICTURE_BYTES if path.endswith(_PICTURES) else _MOST_BYTES


def _host_name(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""
