"""The console's own routes beside NiceGUI's: pictures, orders, and the page's files.

Orders are plain HTTP, so that the emergency stop works as long as the page and the server do, whatever becomes of the
page's websockets. Pictures have a websocket of their own: "after width" is asked, a packet is the answer.
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

from base_station.console.feed import Feed
from base_station.console.line import Lines
from base_station.console.web import starlette
from base_station.orders import Order
from protocol import ProtocolError
from protocol.records import from_map

STATIC = Path(__file__).parent / "static"
PATIENCE_S = 0.4
"""A page that waits for a picture hears of the state at least so often."""
LARGEST_ORDER_BYTES = 4096
LONGEST_QUESTION = 24


def add_routes(application: Any, library: Any, feed: Feed, lines: Lines) -> None:
    """`application`: a FastAPI; `library`: the module."""

    async def picture(request: Any) -> Any:
        body = await feed.picture(_number(request.query_params.get("after", "0")), PATIENCE_S)
        headers = {"cache-control": "no-store"}
        return library.Response(body, media_type="application/octet-stream", headers=headers)

    async def pictures(websocket: Any) -> None:
        await websocket.accept()
        with contextlib.suppress(library.WebSocketDisconnect):
            async for asked in websocket.iter_text():
                after, _, width = asked[:LONGEST_QUESTION].partition(" ")
                await websocket.send_bytes(await feed.picture(_number(after), PATIENCE_S, _number(width)))

    async def order(request: Any) -> Any:
        if request.headers.get("content-type", "").partition(";")[0] != "application/json":
            return library.responses.JSONResponse({"error": "an order is JSON"}, status_code=415)
        try:
            wanted = read_order(await _body(request))
        except ValueError as error:
            return library.responses.JSONResponse({"error": str(error)}, status_code=400)
        return library.responses.JSONResponse({"error": await lines.order(wanted)})

    application.add_route("/picture", picture, methods=["GET"])
    application.router.routes.append(starlette().routing.WebSocketRoute("/pictures", pictures))
    application.add_route("/order", order, methods=["POST"])
    application.mount("/static", library.staticfiles.StaticFiles(directory=STATIC))


def _number(text: str) -> int:
    """0 where it is none."""
    return int(text) if text.isdecimal() and len(text) < 12 else 0


async def _body(request: Any) -> bytes:
    """Raises ValueError when it is too long."""
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > LARGEST_ORDER_BYTES:
            raise ValueError("this order is too long")
    return bytes(body)


def read_order(body: bytes) -> Order:
    """An order out of JSON. Raises ValueError, saying what is wrong."""
    try:
        return from_map(Order, json.loads(body))
    except (ProtocolError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(str(error)) from error
