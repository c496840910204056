"""Wheel trim: no two motors are alike, and a robot whose wheels get equal targets drives a circle instead of a line.

The robot drives with equal speeds for some seconds from a line on the floor; a person measures how far it came along
the line and how far it ended beside it. It drove an arc that touches the line at its start: with d ahead and y to the
left the arc has the radius R = (d^2 + y^2) / 2y, and the wheels, half a base b to either side of the middle, ran

    right / left = (R + b/2) / (R - b/2).

That ratio is the trim. After a metre, 1 % of it shows as 5 cm beside the line.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from robot_agent.errors import AgentError, UsageError
from robot_agent.robots.base import Robot
from robot_agent.safety import LinkState, SafetySettings, SafetyState, SafetySupervisor, WheelCommand
from robot_agent.settings_file import MAX_TRIM, MIN_TRIM

LONGEST_RUN_CM = 1000.0
PERIOD_S = 0.02
RAMP_S = 1.0
"""A bus writes one wheel's target before the other's. At a standing start that turns the robot by a degree now and
then, which looks like 1 % of trim; spread over a slow start it averages out."""


def wheel_ratio(ran_cm: float, veered_cm: float, wheel_base_cm: float) -> float:
    """Right wheel's way over the left's, of a run that came `ran_cm` along its first direction and ended `veered_cm` to
    the left of it (to the right: negative).

    Raises UsageError for a run that is none: no way ahead, or ending more beside the line than along it.
    """
    if not 0 < ran_cm <= LONGEST_RUN_CM:
        raise UsageError(f"--ran-cm {ran_cm:g}: the way along the line is above 0 and up to {LONGEST_RUN_CM:g} cm.")
    if not abs(veered_cm) < ran_cm:
        raise UsageError(
            f"--veered-cm {veered_cm:g}: a robot that ends further beside its line than along it "
            f"({ran_cm:g} cm) has a blocked wheel rather than a trim."
        )
    if veered_cm == 0:
        return 1.0
    radius_cm = (ran_cm**2 + veered_cm**2) / (2 * veered_cm)
    return (radius_cm + wheel_base_cm / 2) / (radius_cm - wheel_base_cm / 2)


def new_trim(ratio: float, old_trim: float, speed: int) -> float:
    """The trim to store after a run with `old_trim` in force, at `speed` motor units.

    The driver gives the right wheel a whole number of units: what was really asked of it counts. Raises AgentError when
    the result is beyond what a trim may be.
    """
    trim = ratio * speed / round(speed / old_trim)
    if not MIN_TRIM <= trim <= MAX_TRIM:
        raise AgentError(
            f"A trim of {trim:.2f} would mean that one wheel hardly turns: look at the wheels, then measure again."
        )
    return trim


def drive_straight(
    robot: Robot,
    speed: int,
    duration_s: float,
    stopped: Callable[[], bool],
    *,
    safety: SafetySettings,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Drive with both wheels at `speed` motor units for that long, the slow start included; stop at once on any doubt.

    Raises AgentError when it was cut short: by the supervisor (obstacle, edge, lifted, robot away), by the robot's
    button, or because `stopped` says so. The wheels are told to stand in every case.
    """
    supervisor = SafetySupervisor(safety)
    begun_s = clock()
    try:
        while (now_s := clock()) < begun_s + duration_s:
            if stopped():
                raise AgentError("Stopped by hand; nothing was stored.")
            state = robot.state()
            if state.button:
                raise AgentError("Stopped by the robot's button; nothing was stored.")
            units = round(speed * min(1.0, (now_s - begun_s + PERIOD_S) / RAMP_S))
            decision = supervisor.step(
                now_s,
                WheelCommand(units, units, now_s),
                state.proximity,
                LinkState(connected=True, last_frame_s=now_s, problem=state.problem),
                ground=state.ground,
                acceleration=state.acceleration,
            )
            if decision.state is not SafetyState.OK:
                raise AgentError(
                    f"Stopped after {now_s - begun_s:.1f} s: {decision.reason}. Nothing was stored; give the robot a "
                    "free floor and start again."
                )
            robot.set_wheels(decision.left, decision.right)
            sleep(PERIOD_S)
    finally:
        robot.set_wheels(0, 0)


def expected_cm(speed: int, duration_s: float, metres_per_unit_s: float) -> float:
    """How far that run goes."""
    return 100 * speed * max(duration_s - RAMP_S / 2, duration_s / 2) * metres_per_unit_s
