"""Who may ask the server: this page only, and from elsewhere only who has the token."""

from __future__ import annotations

import hmac
import ipaddress
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE = "ballplate_token"


def is_loopback(host: str) -> bool:
    """Whether a host, by name or address, is this machine and nothing else."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


class Guard:
    """An ASGI application that lets another one answer only those who may ask.

    A page of another origin may not, whatever browser it runs in: neither open a connection nor,
    by a name that leads to this machine, read what is served.

    Args:
        app: Who answers.
        token: What the address must carry as ``?token=``, or a cookie that is set then; empty for
            a server that is reached from this machine only.
    """

    def __init__(self, app: App, token: str = "") -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, refuse, or do what is no answer to anybody."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
        elif not self._may(scope):
            await _refuse(scope, send)
        else:
            await self._app(scope, receive, self._marked(scope, send))

    def _may(self, scope: Scope) -> bool:
        headers = {
            name.decode("latin-1"): text.decode("latin-1") for name, text in scope["headers"]
        }
        host, origin = headers.get("host", ""), headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return False
        if not self._token:
            return is_loopback(urlsplit(f"//{host}").hostname or "")
        cookies = SimpleCookie(headers.get("cookie", ""))
        given = [cookies[COOKIE].value] if COOKIE in cookies else []
        return any(hmac.compare_digest(each, self._token) for each in (*given, *_asked(scope)))

    def _marked(self, scope: Scope, send: Send) -> Send:
        """Sends a cookie along to who has come with the token in the address."""
        if not (self._token and scope["type"] == "http" and _asked(scope)):
            return send
        cookie = f"{COOKIE}={self._token}; Path=/; HttpOnly; SameSite=Strict"

        async def sent(message: Any) -> None:
            if message["type"] == "http.response.start":
                headers = [*message.get("headers", ()), (b"set-cookie", cookie.encode())]
                message = {**message, "headers": headers}
            await send(message)

        return sent


def _asked(scope: Scope) -> list[str]:
    """The tokens in an address."""
    return parse_qs(scope["query_string"].decode("latin-1")).get("token", [])


async def _refuse(scope: Scope, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    text = b"refused: the address needs ?token=..., as ballplate play has printed it\n"
    kind = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": 403, "headers": kind})
    await send({"type": "http.response.body", "body": text})
