"""Keys as a terminal sends them, by name."""

from __future__ import annotations

import os
import pty
import queue
import sys
import termios

import pytest

from base_station.terminal import key_names, pressed_keys


@pytest.mark.parametrize(
    ("data", "names"),
    [
        (b"", []),
        (b"w", ["w"]),
        (b"W", ["w"]),
        (b" ", [" "]),
        (b"wasd", ["w", "a", "s", "d"]),
        (b"\x1b[A", ["up"]),
        (b"\x1b[B\x1b[C\x1b[D", ["down", "right", "left"]),
        (b"\x1bOA\x1bOB", ["up", "down"]),
        (b"a\x1b[Cd", ["a", "right", "d"]),
        (b"\x1b", []),
        (b"\x1b[5~", []),
        (b"w\x1b[24~", ["w"]),
    ],
)
def test_what_a_terminal_sends_becomes_names(data, names):
    assert key_names(data) == names


def test_without_a_terminal_there_are_no_keys(monkeypatch):
    read_end, write_end = os.pipe()
    with os.fdopen(read_end) as pipe:
        monkeypatch.setattr(sys, "stdin", pipe)
        with pressed_keys() as keys:
            assert keys is None
    os.close(write_end)


def test_keys_of_a_real_terminal_arrive_at_once_and_it_is_given_back_as_it_was(monkeypatch):
    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    with os.fdopen(slave) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        with pytest.raises(RuntimeError, match="sudden end"), pressed_keys() as keys:
            assert keys is not None
            assert not termios.tcgetattr(slave)[3] & termios.ICANON
            os.write(master, b"w\x1b[A")
            assert [keys.get(timeout=2), keys.get(timeout=2)] == ["w", "up"]
            with pytest.raises(queue.Empty):
                keys.get_nowait()
            raise RuntimeError("sudden end")
        assert termios.tcgetattr(slave)[3] == before[3]
    os.close(master)
