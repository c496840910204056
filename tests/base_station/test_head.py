"""Where the camera looked: the angles of the very frame, else the newest of its connection; memory is bounded."""

from __future__ import annotations

from base_station.head import HeadAngles
from protocol import FrameStamp


def stamp(number: int, pan_rad: float | None) -> FrameStamp:
    tilt_rad = None if pan_rad is None else 0.0
    return FrameStamp(connection=1, number=number, capture_s=0.0, dropped=0, pan_rad=pan_rad, tilt_rad=tilt_rad)


def test_angles_are_those_of_the_frame_and_late_ones_the_newest_of_the_connection():
    angles = HeadAngles()
    angles.note("a", stamp(1, 0.1))
    angles.note("a", stamp(2, 0.2))
    angles.note("b", stamp(1, 0.9))
    assert angles.of(("a", 1)) == (0.1, 0.0)
    assert angles.of(("a", 3)) == (0.2, 0.0)
    assert angles.of(("c", 1)) is None


def test_a_fixed_camera_has_no_angles_and_memory_is_bounded():
    angles = HeadAngles()
    angles.note("a", stamp(1, None))
    assert angles.of(("a", 1)) is None
    for number in range(2, 2000):
        angles.note("a", stamp(number, 0.1))
    assert len(angles._known) <= 256
