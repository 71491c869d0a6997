"""Who may ask the server: this page only, and from elsewhere only who has the token."""

from __future__ import annotations

import hmac
import ipaddress
from collections.abc import Awaitable, Callable, MutableMapping
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from starlette.requests import HTTPConnection

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE = "ballplate_token"
REFUSED = "refused: the address needs ?token=..., as ballplate play has printed it\n"


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
        from starlette.requests import HTTPConnection  # noqa: PLC0415 - of the extra
        from starlette.responses import PlainTextResponse  # noqa: PLC0415

        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        asked = HTTPConnection(scope)
        token = asked.query_params.get("token", "")
        if self._may(asked, token):
            marked = self._token and token and scope["type"] == "http"
            await self._app(scope, receive, self._marking(send) if marked else send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await PlainTextResponse(REFUSED, 403)(scope, receive, send)

    def _may(self, asked: HTTPConnection, token: str) -> bool:
        host, origin = asked.headers.get("host", ""), asked.headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return False
        if not self._token:
            return is_loopback(urlsplit(f"//{host}").hostname or "")
        given = (asked.cookies.get(COOKIE, ""), token)
        return any(hmac.compare_digest(each.encode(), self._token.encode()) for each in given)

    def _marking(self, send: Send) -> Send:
        """Sends a cookie along to who has come with the token in the address."""
        cookie = f"{COOKIE}={self._token}; Path=/; HttpOnly; SameSite=Strict"

        async def sent(message: Any) -> None:
            if message["type"] == "http.response.start":
                headers = [*message.get("headers", ()), (b"set-cookie", cookie.encode())]
                message = {**message, "headers": headers}
            await send(message)

        return sent
