"""Servos on a Raspberry Pi's pins through ServoBlaster, as the Pi-Pan of the thesis is driven.

ServoBlaster's daemon (servod) reads lines such as `0=1500us` or `P1-7=1500us` from a FIFO and makes the pulses. It
never answers, and its FIFO may be full, without reader, or not there: nothing here waits for it. A thread walks the
servos from pulse to pulse at the slew rate, and finds the daemon again when it was restarted.

Lines and pulse limits: servod.c and README.txt of ServoBlaster in R. Hirst's PiBits.
"""

from __future__ import annotations

import errno
import logging
import os
import re
import stat
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from protocol import PanTiltLimits
from robot_agent.errors import PanTiltError, UsageError
from robot_agent.pantilt.slew import PI_PAN, SERVO_LAG_S, Slew

log = logging.getLogger(__name__)

SHORTEST_US, LONGEST_US = 500, 2500
"""servod refuses other pulses unless it was started with other limits; 0 would switch the servo off."""
STEP_US = 10
"""servod cuts pulses to such steps; we round, and know which angle the camera really has."""
PERIOD_S = 0.02
"""Servos take one pulse in this time; more lines than that are for nothing."""
RETRY_S = 0.5
CLOSE_PATIENCE_S = 1.0
MEMORY_S = 1.0

_SERVO = re.compile(r"\d{1,2}|P[15]-\d{1,2}")


@dataclass(frozen=True, kw_only=True)
class ServoBlasterSettings:
    """How the servos are connected. Raises UsageError for what ServoBlaster would not understand."""

    device: str = "/dev/servoblaster"
    pan_servo: str = "0"
    """ServoBlaster's number of the servo (0..31), or its pin, such as P1-7."""
    tilt_servo: str = "1"
    pan_pulse_us: tuple[int, int] = (600, 2400)
    """Pulses at the limits right and left; the first may be the longer one, for a servo that is mounted the other
    way."""
    tilt_pulse_us: tuple[int, int] = (950, 2050)
    """Pulses at the limits down and up."""
    limits: PanTiltLimits = PI_PAN

    def __post_init__(self) -> None:
        for servo in (self.pan_servo, self.tilt_servo):
            if not _SERVO.fullmatch(servo):
                raise UsageError(f"{servo!r} is no servo of ServoBlaster: give its number, or its pin such as P1-7.")
        if self.pan_servo == self.tilt_servo:
            raise UsageError(f"Pan and tilt cannot both be servo {self.pan_servo}.")
        for pulses in (self.pan_pulse_us, self.tilt_pulse_us):
            if not all(SHORTEST_US <= pulse <= LONGEST_US for pulse in pulses) or abs(pulses[0] - pulses[1]) < STEP_US:
                raise UsageError(
                    f"Pulses {pulses[0]}:{pulses[1]} us: give two different ones from {SHORTEST_US} to {LONGEST_US}."
                )

    def pulses_us(self, pan_rad: float, tilt_rad: float) -> dict[str, int]:
        """Pulse width by servo, in whole steps of servod, for angles within the limits."""
        return {
            self.pan_servo: _pulse_us(pan_rad, self.limits.pan_rad, self.pan_pulse_us),
            self.tilt_servo: _pulse_us(tilt_rad, self.limits.tilt_rad, self.tilt_pulse_us),
        }

    def angles_rad(self, pan_rad: float, tilt_rad: float) -> tuple[float, float]:
        """The angles that the pulses for these angles make: a step is about a degree."""
        pulses = self.pulses_us(pan_rad, tilt_rad)
        return (
            _angle_rad(pulses[self.pan_servo], self.limits.pan_rad, self.pan_pulse_us),
            _angle_rad(pulses[self.tilt_servo], self.limits.tilt_rad, self.tilt_pulse_us),
        )


def _pulse_us(angle_rad: float, span_rad: tuple[float, float], span_us: tuple[int, int]) -> int:
    (low_rad, high_rad), (low_us, high_us) = span_rad, span_us
    return STEP_US * round((low_us + (angle_rad - low_rad) / (high_rad - low_rad) * (high_us - low_us)) / STEP_US)


def _angle_rad(pulse_us: int, span_rad: tuple[float, float], span_us: tuple[int, int]) -> float:
    (low_rad, high_rad), (low_us, high_us) = span_rad, span_us
    return low_rad + (pulse_us - low_us) / (high_us - low_us) * (high_rad - low_rad)


class ServoBlaster:
    """Implements PanTilt. Centres the camera at its start and at its end. `clock` must be that of the camera.

    Raises PanTiltError when the device is not there or nobody reads it; later that is an error of `look`, until the
    daemon is back.
    """

    def __init__(
        self, settings: ServoBlasterSettings | None = None, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._settings = settings or ServoBlasterSettings()
        self.limits = self._settings.limits
        self._clock = clock
        self._slew = Slew(self.limits)
        self._told: dict[str, int] = {}
        self._device: int | None = _open(self._settings.device)
        self._problem = ""
        self._changed = threading.Condition()
        self._closing_s: float | None = None
        self._thread = threading.Thread(target=self._run, name="servos", daemon=True)
        self._thread.start()

    def look(self, pan_rad: float, tilt_rad: float) -> None:
        """See PanTilt.look."""
        with self._changed:
            if self._problem:
                raise PanTiltError(self._problem)
            self._slew.look(self._clock(), pan_rad, tilt_rad)
            self._changed.notify()

    def angles_at(self, time_s: float) -> tuple[float, float]:
        """See PanTilt.angles_at. A time that is not of the last second is of another clock (a recording's): then the
        present counts."""
        with self._changed:
            now_s = self._clock()
            then_s = time_s if now_s - MEMORY_S <= time_s <= now_s else now_s
            return self._settings.angles_rad(*self._slew.at(then_s - SERVO_LAG_S))

    def close(self) -> None:
        """Centre the camera and wait for it, but no longer than the way and a second take. May be called twice."""
        with self._changed:
            if self._closing_s is None:
                self._slew.look(self._clock(), 0.0, 0.0)
                self._closing_s = max(self._clock(), self._slew.arrival_s())
                self._changed.notify()
        way_s = 2.0 * max(*self.limits.pan_rad, *self.limits.tilt_rad) / self.limits.slew_rad_s
        self._thread.join(way_s + 2.0 * CLOSE_PATIENCE_S)
        if self._device is not None:
            os.close(self._device)
            self._device = None

    # -- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        with self._changed:
            while not self._finished(self._follow()):
                moving = self._clock() < self._slew.arrival_s()
                rest_s = RETRY_S if self._problem else None if self._all_told() and not moving else PERIOD_S
                if self._closing_s is not None:
                    rest_s = PERIOD_S
                self._changed.wait(rest_s)

    def _follow(self) -> bool:
        """Bring the servos up to now. Whether that was possible."""
        if self._device is None and not self._reopen():
            return False
        pulses = self._settings.pulses_us(*self._slew.at(self._clock()))
        lines = "".join(f"{servo}={pulse}us\n" for servo, pulse in pulses.items() if self._told.get(servo) != pulse)
        if not lines:
            return True
        assert self._device is not None
        try:
            os.write(self._device, lines.encode())  # less than PIPE_BUF: all of it or nothing
            self._told = pulses
        except BlockingIOError:
            log.debug("%s is full", self._settings.device)  # newer pulses are tried in the next period
        except OSError as error:
            self._lose(f"The servos are gone: {self._settings.device} broke ({error.strerror}); is servod running?")
            return False
        return True

    def _finished(self, reached: bool) -> bool:
        if self._closing_s is None or self._clock() < self._closing_s:
            return self._closing_s is not None and not reached
        return self._all_told() or not reached or self._clock() > self._closing_s + CLOSE_PATIENCE_S

    def _all_told(self) -> bool:
        return self._told == self._settings.pulses_us(*self._slew.at(self._clock()))

    def _lose(self, problem: str) -> None:
        if self._device is not None:
            os.close(self._device)
            self._device = None
        self._told = {}
        self._problem = problem
        log.warning("%s", problem)

    def _reopen(self) -> bool:
        try:
            self._device = _open(self._settings.device)
        except PanTiltError as error:
            self._problem = str(error)
            return False
        self._problem = ""
        log.info("the servos are back")
        return True


def _open(device: str) -> int:
    """A descriptor for writing that never blocks. Raises PanTiltError, in words."""
    start = "start ServoBlaster (sudo servod)"
    try:
        descriptor = os.open(device, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError as error:
        raise PanTiltError(f"There is no servo device {device}: {start}, or name it with --servo-device.") from error
    except OSError as error:
        if error.errno == errno.ENXIO:
            raise PanTiltError(f"Nobody reads the servo device {device}: {start}.") from error
        raise PanTiltError(f"The servo device {device} cannot be written ({error.strerror}).") from error
    mode = os.fstat(descriptor).st_mode
    if not (stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)):
        os.close(descriptor)
        raise PanTiltError(f"{device} is a file, not ServoBlaster's device: remove it and {start}.")
    return descriptor
