"""What the station sees reaches the robot's lights: changes only, the newest, and the loop waits for none of it."""

from __future__ import annotations

import threading
import time

import pytest

from base_station.announcer import Announcer
from base_station.sockets import LinkLost
from protocol import Reply, Request
from tests.helpers import wait_until


class SlowRobot:
    """Answers when the test lets it."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.may_answer = threading.Event()
        self.failure: Exception | None = None

    def ask(self, request: Request) -> Reply:
        assert request.action == "show"
        self.asked.append(request.text)
        assert self.may_answer.wait(5.0)
        if self.failure is not None:
            raise self.failure
        return Reply(ok=True)


def test_only_changes_are_told_and_a_new_connection_is_told_again():
    robot = SlowRobot()
    robot.may_answer.set()
    with Announcer(robot.ask) as announcer:
        for word, connection in [("tracking", "a"), ("tracking", "a"), ("lost", "a"), ("lost", "b"), ("lost", "b")]:
            said = len(robot.asked)
            announcer.say(word, connection)
            time.sleep(0.02)
            assert len(robot.asked) <= said + 1
    assert robot.asked == ["tracking", "lost", "lost"]


def test_a_robot_that_hangs_costs_the_loop_nothing_and_hears_the_newest():
    robot = SlowRobot()
    with Announcer(robot.ask) as announcer:
        announcer.say("tracking", "a")
        wait_until(lambda: robot.asked, 1.0, "the first word")
        begun_s = time.perf_counter()
        for number in range(1000):
            announcer.say(("lost", "idle", "tracking")[number % 3], "a")
        announcer.say("idle", "a")
        assert time.perf_counter() - begun_s < 0.1, "a thousand words in the loop's time"
        robot.may_answer.set()
        wait_until(lambda: len(robot.asked) == 2, 1.0, "the newest word")
    assert robot.asked == ["tracking", "idle"]


@pytest.mark.parametrize("failure", [LinkLost("no answer"), None])
def test_a_word_that_does_not_arrive_is_dropped_and_the_next_one_is_told(failure):
    robot = SlowRobot()
    robot.may_answer.set()
    robot.failure = failure
    with Announcer(robot.ask) as announcer:
        announcer.say("tracking", "a")
        wait_until(lambda: len(robot.asked) == 1, 1.0, "the first word")
        announcer.say("lost", "a")
        wait_until(lambda: len(robot.asked) == 2, 1.0, "the second word")
