"""Keys from the terminal, read as they are pressed. Without a terminal on standard input there are none."""

from __future__ import annotations

import contextlib
import os
import queue
import select
import sys
import termios
import threading
import tty
from collections.abc import Iterator

ARROWS = {b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left"}
ARROWS |= {sequence.replace(b"[", b"O"): name for sequence, name in ARROWS.items()}


@contextlib.contextmanager
def pressed_keys() -> Iterator[queue.SimpleQueue[str] | None]:
    """A queue of key names ("a", " ", "up", ...) while the context lasts; None without a terminal.

    The terminal is given back as it was, whatever ends the context.
    """
    if not sys.stdin.isatty():
        yield None
        return
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    keys: queue.SimpleQueue[str] = queue.SimpleQueue()
    closing = threading.Event()
    thread = threading.Thread(target=_read, args=(descriptor, keys, closing), name="keys", daemon=True)
    try:
        tty.setcbreak(descriptor)
        thread.start()
        yield keys
    finally:
        closing.set()
        thread.join()
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _read(descriptor: int, keys: queue.SimpleQueue[str], closing: threading.Event) -> None:
    while not closing.is_set():
        if not select.select([descriptor], [], [], 0.1)[0]:
            continue
        data = os.read(descriptor, 64)
        if not data:
            return
        for name in key_names(data):
            keys.put(name)


def key_names(data: bytes) -> list[str]:
    """The keys in what a terminal sent at once. Unknown escape sequences are passed over."""
    names: list[str] = []
    while data:
        if data[:3] in ARROWS:
            names.append(ARROWS[data[:3]])
            data = data[3:]
        elif data[:1] == b"\x1b":
            return names
        else:
            names.append(chr(data[0]).lower())
            data = data[1:]
    return names
