"""Which band is asked for, when, and what happens when the robot refuses or says nothing."""

from __future__ import annotations

import logging

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from base_station.rows import STEP, RowSwitch, band_for, united
from base_station.sockets import LinkLost
from protocol import FrameFormat, Reply, Request

HEIGHT = 480
WHOLE = FrameFormat(width=640, height=HEIGHT)
FAR = 10**6
rows = st.tuples(st.integers(-FAR, FAR), st.integers(-FAR, FAR))


class Robot:
    """The control line's far end: answers from a list, and remembers what it was asked."""

    def __init__(self, *replies: Reply | LinkLost) -> None:
        self.replies, self.asked = list(replies), []

    def ask(self, request: Request, timeout_s: float) -> Reply:
        assert timeout_s > 0
        self.asked.append(request)
        reply = self.replies.pop(0)
        if isinstance(reply, LinkLost):
            raise reply
        return reply


class Stream:
    """Remembers the switches that it was told."""

    def __init__(self) -> None:
        self.switches: list[tuple[FrameFormat, int]] = []

    def switch(self, frame_format: FrameFormat, number: int) -> None:
        self.switches.append((frame_format, number))


@pytest.mark.parametrize(
    ("wishes", "together"),
    [
        ([(100, 200)], (100, 200)),
        ([(100, 200), (150, 300)], (100, 300)),
        ([(100, 200), None], None),
        ([None], None),
        ([], None),
    ],
)
def test_a_band_serves_all_trackers_or_the_frames_stay_whole(wishes, together):
    assert united(wishes) == together


@given(wanted=rows, present=st.none() | rows)
@settings(derandomize=True, max_examples=300, deadline=None)
def test_whatever_is_wanted_the_band_lies_in_the_frame_and_holds_it(wanted, present):
    band = band_for(wanted, present, HEIGHT)
    if band is None or band == present:
        return
    first, past_last = band
    assert 0 <= first < past_last <= HEIGHT
    assert first % STEP == 0 and past_last % STEP == 0
    assert first <= max(wanted[0], 0) and min(wanted[1], HEIGHT) <= past_last
    WHOLE.band(band)


def test_a_band_stays_while_the_wanted_rows_lie_in_it_and_it_is_not_far_too_large():
    band = band_for((200, 300), None, HEIGHT)
    assert band == (192, 308)
    assert band_for((192, 300), band, HEIGHT) == band
    assert band_for((191, 300), band, HEIGHT) == (184, 308)
    assert band_for((230, 290), band, HEIGHT) == (224, 296)
    assert band_for(None, band, HEIGHT) is None
    assert band_for((40, 460), None, HEIGHT) is None, "hardly anything to save"
    assert band_for((-50, 60), None, HEIGHT) == (0, 68)


def test_the_switch_is_made_where_the_robot_says_and_only_when_needed():
    robot, stream = Robot(Reply(ok=True, frame=12), Reply(ok=True, frame=40)), Stream()
    switch = RowSwitch(robot, WHOLE, "10.0.0.2:5000")
    switch.act(stream)
    switch.want((200, 300))
    for _ in range(3):
        switch.act(stream)
    switch.want(None)
    switch.act(stream)
    assert robot.asked == [
        Request(action="rows", rows=(192, 308), station="10.0.0.2:5000"),
        Request(action="rows", rows=None, station="10.0.0.2:5000"),
    ]
    assert stream.switches == [(WHOLE.band((192, 308)), 12), (WHOLE, 40)]


def test_rows_are_counted_from_the_first_that_the_agent_was_started_with():
    narrow = FrameFormat(width=640, height=280, first_row=100, full_height=HEIGHT)
    robot, stream = Robot(Reply(ok=True, frame=2)), Stream()
    switch = RowSwitch(robot, narrow, "")
    switch.want((40, 80))
    switch.act(stream)
    assert robot.asked[0].rows == (136, 184)
    assert stream.switches == [(narrow.band((136, 184)), 2)]


def test_a_robot_that_refuses_is_told_of_once_and_the_frames_stay_whole(caplog):
    robot, stream = Robot(Reply(ok=False, error="not you")), Stream()
    switch = RowSwitch(robot, WHOLE, "")
    with caplog.at_level(logging.WARNING):
        for wanted in ((200, 300), (100, 150), None):
            switch.want(wanted)
            switch.act(stream)
    assert stream.switches == [] and len(robot.asked) == 1
    assert [record.getMessage() for record in caplog.records] == [
        "the robot refuses (not you): --rows changes nothing, the frames stay whole."
    ]


@pytest.mark.parametrize("reply", [LinkLost("no answer"), Reply(ok=False, error="no more")])
def test_when_nobody_knows_how_long_the_frames_are_the_connection_ends(reply):
    switch = RowSwitch(Robot(Reply(ok=True, frame=2), reply), WHOLE, "")
    switch.want((200, 300))
    switch.act(Stream())
    switch.want(None)
    with pytest.raises(LinkLost):
        switch.act(Stream())


def test_a_frame_that_telemetry_knows_otherwise_ends_the_connection():
    """Somebody else had the rows changed: the frame was cut out of the stream at the wrong place."""
    switch = RowSwitch(Robot(), WHOLE, "")
    switch.note(4, None)
    switch.note(5, (192, 308))
    switch.check(4, WHOLE)
    switch.check(5, WHOLE.band((192, 308)))
    switch.check(6, WHOLE)
    for number, sent in ((4, WHOLE.band((0, 8))), (5, WHOLE)):
        with pytest.raises(LinkLost, match="other rows"):
            switch.check(number, sent)
