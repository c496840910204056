"""The console's process: told by one line of JSON on standard input where to serve what; ends when that input does."""

from __future__ import annotations

import json
import signal
import socket
import sys
import threading
from pathlib import Path

from base_station.console.feed import Feed
from base_station.console.gate import Gate
from base_station.console.launcher import OPENED, Instructions
from base_station.console.line import Lines
from base_station.console.page import add_page
from base_station.console.routes import add_routes
from base_station.console.web import fastapi, nicegui, uvicorn
from base_station.publication.schema import Addresses
from protocol.records import from_map

FAREWELL_S = 0.7
"""After the station's end: so long pages can still hear of it."""


def main() -> int:
    """Returns the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    told = from_map(Instructions, json.loads(sys.stdin.readline()))
    addresses = Addresses(Path(told.folder))
    feed, lines = Feed(addresses, lambda: print(OPENED, flush=True)), Lines(addresses)
    application = fastapi().FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    add_routes(application, fastapi(), feed, lines)
    add_page(nicegui(), feed, lines)
    nicegui().ui.run_with(application, title="zservo console", favicon="🤖", dark=None, show_welcome_message=False)
    server = uvicorn().Server(
        uvicorn().Config(
            Gate(application, told.token, told.port),
            log_level="error",
            access_log=False,
            timeout_graceful_shutdown=1,
            server_header=False,
            ws_per_message_deflate=False,  # pictures are packed as they are
        )
    )
    feed.start()
    threading.Thread(target=_end_with_station, args=(feed, server), name="station", daemon=True).start()
    server.run(sockets=[socket.socket(fileno=told.descriptor)])
    feed.close()
    lines.close()
    return 0


def _end_with_station(feed: Feed, server: object) -> None:
    """The station holds the other end of standard input."""
    while sys.stdin.readline():
        pass
    feed.end()
    threading.Event().wait(FAREWELL_S)
    server.should_exit = True  # type: ignore[attr-defined]


if __name__ == "__main__":
    sys.exit(main())
