"""Who may in: stands before every route, the websocket's too.

On loopback everybody of this machine may, but only from pages of the console itself: a page of the web that is open in
the same browser must neither drive the robot (its `Origin` tells) nor call itself by a name that leads here (`Host`).
On any other address a visitor shows the token once, as part of the address, and from then on by a cookie.
"""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

LOOPBACK_NAMES = ("127.0.0.1", "localhost", "::1")
TOKEN = "token"
GUARDS = (
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"content-security-policy", b"frame-ancestors 'none'"),
)
"""With every answer: the token stays here, and no other page shows this one within itself."""


@dataclass(frozen=True)
class Verdict:
    """`status`: 200 may in, 303 may in with a cookie and without the token in the address, else why not, in words."""

    status: int
    words: str = ""


class Gate:
    """An ASGI application around another. `token`: None on loopback. `port` makes the cookie's name: browsers do not
    keep cookies apart by port."""

    def __init__(self, app: App, token: str | None, port: int) -> None:
        self.app = app
        self._token, self._cookie = token, f"zservo-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        verdict = self.judge(_headers(scope), scope.get("query_string", b"").decode("latin-1"))
        if verdict.status == 200:
            await self.app(scope, receive, _guarded(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
        else:
            await self._refuse(verdict, scope, _guarded(send))

    def judge(self, headers: dict[str, str], query: str) -> Verdict:
        """`headers` by lower-case names; `query` as in the address."""
        host = headers.get("host", "")
        if self._token is None and _name(host) not in LOOPBACK_NAMES:
            return Verdict(403, "This console answers by the names 127.0.0.1 and localhost only.")
        origin = headers.get("origin")
        if origin is not None and _place(origin) != host:
            return Verdict(403, "Another page may not use this console.")
        if self._token is None or self._is_token(self._shown(headers)):
            return Verdict(200)
        if self._is_token(dict(parse_qsl(query)).get(TOKEN, "")):
            return Verdict(303)
        return Verdict(401, "This console needs the token: open the address that the station's terminal printed.")

    def _is_token(self, given: str) -> bool:
        assert self._token is not None
        return hmac.compare_digest(given.encode(), self._token.encode())

    def _shown(self, headers: dict[str, str]) -> str:
        try:
            morsel = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            return ""
        return morsel.value if morsel is not None else ""

    async def _refuse(self, verdict: Verdict, scope: Scope, send: Send) -> None:
        headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"cache-control", b"no-store")]
        if verdict.status == 303:
            query = [(k, v) for k, v in parse_qsl(scope.get("query_string", b"").decode("latin-1")) if k != TOKEN]
            path = "/" + scope.get("path", "/").lstrip("/")  # never //elsewhere, which would lead away
            place = path + ("?" + urlencode(query) if query else "")
            cookie = f"{self._cookie}={self._token}; Path=/; HttpOnly; SameSite=Lax"
            headers += [(b"location", place.encode("latin-1", "ignore")), (b"set-cookie", cookie.encode())]
        await send({"type": "http.response.start", "status": verdict.status, "headers": headers})
        await send({"type": "http.response.body", "body": verdict.words.encode()})


def _headers(scope: Scope) -> dict[str, str]:
    return {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}


def _place(origin: str) -> str:
    """host:port of an origin; empty when it is none."""
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return ""


def _name(host: str) -> str:
    """Of host:port, without the port."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _guarded(send: Send) -> Send:
    async def sending(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", ()), *GUARDS]
        await send(message)

    return sending
