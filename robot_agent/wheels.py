"""The wheels' one master: everything that bears on them comes together here, the supervisor decides, the robot obeys.

Commands, pictures, connections and failures are reported from several threads; each asks for a decision at once, and
the safety thread asks a hundred times a second besides. A robot that itself fails is told to stop, and the agent ends.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator

from protocol import Command
from robot_agent.ports import Peer, StationPort
from robot_agent.robots.base import Robot, RobotState
from robot_agent.safety import Decision, LinkState, SafetyState, SafetySupervisor, WheelCommand

log = logging.getLogger(__name__)


class Wheels:
    """May be used from any thread.

    `clock` is what safety measures time with, `speed_scale` is in motor units per wire unit; `on_change` is called when
    the state or its reason has changed.
    """

    def __init__(
        self,
        robot: Robot,
        supervisor: SafetySupervisor,
        *,
        frame_port: StationPort,
        command_port: StationPort,
        speed_scale: float,
        clock: Callable[[], float],
        on_change: Callable[[], None],
    ) -> None:
        self.decision = Decision(0, 0, SafetyState.STOPPED, "starting")
        self.robot_state = RobotState()
        """The sensors as of the newest decision."""
        self.robot_failure = ""
        """Why the robot cannot be driven any more, in words."""
        self._robot, self._supervisor = robot, supervisor
        self._frame_port, self._command_port = frame_port, command_port
        self._speed_scale, self._clock = speed_scale, clock
        self._on_change = on_change
        self._lock = threading.RLock()
        self._command: WheelCommand | None = None
        self._commander: Peer | None = None
        self._accompanied: Peer | None = None
        self._last_frame_s: float | None = None
        self._awaiting = False
        self._button_was_pressed = False
        self._problem = ""
        self._camera_problem = ""
        self._station_sees = "idle"
        self._shown = ""

    def take_command(self, command: Command, peer: Peer) -> None:
        """A command came from this peer. It holds only as long as the peer is there."""
        with self._lock:
            scale = self._speed_scale
            self._command = WheelCommand(command.left * scale, command.right * scale, self._clock())
            self._commander = peer
        self.decide()

    def station_sees(self, what: str) -> None:
        """What the robot's lights are to tell while its wheels may turn: one of SIGHTS."""
        with self._lock:
            self._station_sees = what
        self.decide()

    def picture_came(self) -> None:
        """The camera lives."""
        with self._lock:
            self._last_frame_s, self._camera_problem = self._clock(), ""

    def camera_is_silent(self, why: str) -> None:
        """The camera gives nothing, as somebody else found out than this clock."""
        with self._lock:
            self._camera_problem = why
        self.decide()

    @contextlib.contextmanager
    def awaiting_command(self) -> Iterator[None]:
        """In lockstep, while the station's command is awaited, nobody asks the camera: its silence means nothing."""
        self._awaiting = True
        try:
            yield
        finally:
            self._awaiting = False

    def forbid(self, why: str) -> None:
        """Stop for good; the first reason stays."""
        with self._lock:
            self._problem = self._problem or why
        self.decide()

    def decide(self) -> None:
        """Ask the supervisor and turn the wheels accordingly."""
        with self._lock:
            before = self.decision
            try:
                self.robot_state = state = self._robot.state()
                self._obey_button(state.button)
                self.decision = self._supervisor.step(
                    self._clock(),
                    self._valid_command(),
                    state.proximity,
                    self._link(),
                    ground=state.ground,
                    acceleration=state.acceleration,
                )
                self._robot.set_wheels(self.decision.left, self.decision.right)
                self._light()
            except Exception as error:
                self._robot_failed(error)
            after = self.decision
        if (after.state, _kind(after.reason)) != (before.state, _kind(before.reason)):
            log.info("wheels %s%s", after.state.value, f": {after.reason}" if after.reason else "")
            self._on_change()

    def _obey_button(self, pressed: bool) -> None:
        """The robot's own button: once stops, once more releases."""
        if pressed and not self._button_was_pressed:
            if self._supervisor.emergency:
                self._supervisor.release()
            else:
                self._supervisor.emergency_stop("the robot's button")
        self._button_was_pressed = pressed

    def _light(self) -> None:
        """What the robot shows tells a bystander why it stands, or what it goes by."""
        if self._command_port.peer is None:
            self._station_sees = "idle"  # the next station may see something else
        what = "stopped" if self.decision.state is SafetyState.STOPPED else self._station_sees
        show = getattr(self._robot, "show", None)
        if show is not None and what != self._shown:
            show(what)
            self._shown = what

    def _robot_failed(self, error: Exception) -> None:
        self.robot_failure = f"the robot failed ({type(error).__name__}: {error})"
        self.decision = Decision(0, 0, SafetyState.STOPPED, self.robot_failure)
        with contextlib.suppress(Exception):  # whatever else is broken: this one call may still go through
            self._robot.set_wheels(0, 0)

    def _valid_command(self) -> WheelCommand | None:
        return self._command if self._commander is self._command_port.peer else None

    def _link(self) -> LinkState:
        commander, watcher = self._command_port.peer, self._frame_port.peer
        if watcher is not None:
            self._accompanied = commander
        # A station that once had frames must keep them; one that never asked for any may drive by other senses.
        connected = commander is not None and (watcher is not None or self._accompanied is not commander)
        return LinkState(
            connected=connected,
            last_frame_s=self._clock() if self._awaiting else self._last_frame_s,
            problem=self._problem or self._camera_problem or self.robot_state.problem,
        )


def _kind(reason: str) -> str:
    """A reason without its figures, which change all the time."""
    return "".join(character for character in reason if not character.isdigit())
