"""Trackers by name and out of files; whoever mistypes is told what there is."""

from __future__ import annotations

import pytest

from base_station.trackers.registry import DEFAULT_TRACKER, UnknownTracker, make_tracker, tracker_names


def test_default_is_there():
    assert DEFAULT_TRACKER == "ztransform"
    assert tracker_names()[0] == DEFAULT_TRACKER


def test_every_name_makes_a_new_one():
    for name in tracker_names():
        assert make_tracker(name) is not make_tracker(name)


def test_unknown_name_lists_the_valid_ones_and_guesses():
    with pytest.raises(UnknownTracker, match=r"did you mean ztransform\?") as caught:
        make_tracker("ztranform")
    assert all(name in str(caught.value) for name in tracker_names())
    with pytest.raises(ValueError, match=r"no tracker 'qqq'\. There are"):
        make_tracker("qqq")


@pytest.mark.parametrize(
    ("source", "kind", "text"),
    [
        ("class Mine:\n    pass\n", "Mine", "no method learn, update, close"),
        ("class MineTracker:\n    pass\n", "Other", "has no class 'Other'; it has MineTracker"),
        ("class Mine:\n    pass\n", "", "say which class"),
        ("import nonsuch_module\n", "Mine", "ModuleNotFoundError"),
        ("class Mine:\n    def __init__(self, size):\n        pass\n", "Mine", r"Mine\(\) failed: TypeError"),
        ("x = = 1\n", "Mine", "SyntaxError"),
        ("import sys\nsys.exit(3)\n", "Mine", "importing .* failed: SystemExit: 3"),
        ("class Mine:\n    def __init__(self):\n        raise SystemExit('bye')\n", "Mine", "failed: SystemExit: bye"),
    ],
)
def test_a_file_without_a_tracker_says_so(tmp_path, source, kind, text):
    path = tmp_path / "mine.py"
    path.write_text(source)
    with pytest.raises(ValueError, match=text):
        make_tracker(f"{path}:{kind}")


def test_a_missing_file_says_so(tmp_path):
    with pytest.raises(ValueError, match="there is no file"):
        make_tracker(f"{tmp_path}/none.py:Mine")


def test_a_file_alone_lacks_its_class():
    with pytest.raises(UnknownTracker, match=r"path/to/file\.py:ClassName"):
        make_tracker("mine.py")


def test_a_tracker_from_a_file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        "from dataclasses import dataclass\n"
        "@dataclass\nclass Mine:\n    n: int = 0\n"
        "    def learn(self, frame, target): pass\n"
        "    def update(self, frame): pass\n"
        "    def close(self): pass\n"
    )
    assert type(make_tracker(f"{path}:Mine")).__name__ == "Mine"
