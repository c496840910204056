"""The station's loop: newest frame in, tracker, behaviour, command out.

For each frame that the loop takes exactly one command goes back, as the thesis's peers expect. The second tracker
(`shadow`) sees the same frames after the command has left, so it costs the robot nothing.
"""

from __future__ import annotations

import logging
import queue
import time
from collections.abc import Callable
from dataclasses import dataclass

from base_station.behaviours.base import Behaviour, Drive, Journey, Outcome
from base_station.behaviours.registry import BehaviourContext, make_behaviour
from base_station.behaviours.route import Route
from base_station.errors import StationError
from base_station.geometry import FlatPose, PinholeCamera
from base_station.head import Angles, PanHead
from base_station.link import Link
from base_station.rows import Rows, united
from base_station.scale import Scale
from base_station.sockets import LinkLost
from base_station.trackers.base import Tracker, WantsRows
from base_station.types import Box, Frame, TrackerResult, TrackingState
from protocol import STOP, Command, ProtocolError, Request, RobotLimits

log = logging.getLogger(__name__)

ScaleMaker = Callable[[Box | None, PinholeCamera], Scale | None]

WAIT_S = 0.1
SIGHT_OF = {TrackingState.TRACKING: "tracking", TrackingState.LOST: "lost"}
"""What the lights are told (one of the protocol's SIGHTS)."""
PATIENCE_S = 10.0
LOCKSTEP_LOOK_S = 0.5
"""In lockstep, where the robot's time stands until the command comes, the camera's goal may take so long to arrive."""
NO_PAN_TILT = (
    "This robot's camera cannot be turned: leave out --pan, or start its agent with --pan-tilt servoblaster "
    "(--pan-tilt sim for the simulated robot)."
)


@dataclass(frozen=True, kw_only=True)
class Step:
    """All that happened with one frame; what display, results and summary are made from."""

    frame: Frame
    result: TrackerResult
    shadow: TrackerResult | None
    command: Command
    pan_rad: float | None = None
    """Where the camera looked, left of the robot's heading, as far as the robot knows; None when it is fixed."""
    learned: bool
    """The target was learned in this frame."""
    tracker_s: float
    """What the tracker took for this frame (learning not included)."""
    frame_to_command_s: float | None
    """Last byte of the frame received to command handed to the socket; None when the command could not be sent."""


@dataclass(frozen=True, kw_only=True)
class StationSettings:
    behaviour: str = "follow"
    pan: bool = False
    """The behaviour may turn the camera."""
    target: Box | None = None
    """Learned in the first frame; None: what the simulated operator says, else the whole view."""
    target_rows: int | None = None
    """Of the target's box learn no more than so many rows, those in the middle."""
    duration_s: float | None = None
    """End after this much of the frames' time; None: until told."""
    max_frames: int | None = None
    until_there: bool = False
    """End when the behaviour's journey is over (see `behaviours.base.Journey`)."""
    rows: bool = False
    """Ask the robot for the rows only that the trackers want."""
    scale: ScaleMaker | None = None
    """From the box that is learned (None: the whole view) and the camera to the scale; results then carry metres."""


class Station:
    """Runs one robot. `on_step` is called after each frame's command has gone out, `on_wait` while no frame comes."""

    def __init__(
        self,
        link: Link,
        tracker: Tracker,
        settings: StationSettings | None = None,
        *,
        shadow: Tracker | None = None,
        keys: queue.SimpleQueue[str] | None = None,
        on_step: Callable[[Step], None] = lambda step: None,
        on_wait: Callable[[], None] = lambda: None,
    ) -> None:
        self._link, self._tracker, self._shadow = link, tracker, shadow
        self.settings = settings or StationSettings()
        self._keys = keys or queue.SimpleQueue()
        self._on_step, self._on_wait = on_step, on_wait
        self._behaviour: Behaviour | None = None
        self._head: PanHead | None = None
        self._driven: FlatPose | None = None
        """Where the robot is in the present frame, by its wheels."""
        self._connection = ""
        self._stopping = False
        self._target = self.settings.target
        self._learn_asked = True
        self._learned = False
        self._learn_error = ""
        self._scale: Scale | None = None
        self._outcome: Outcome | None = None
        self._first_s: float | None = None
        self._frames = 0

    @property
    def outcome(self) -> Outcome | None:
        """How the behaviour's journey ended; None while it goes on, or when the behaviour is no journey."""
        return self._outcome

    @property
    def laps(self) -> int | None:
        """Driven to their end; None when the behaviour drives none."""
        return self._behaviour.laps if isinstance(self._behaviour, Route) else None

    def stop(self) -> None:
        """End the loop after the present frame; signal handlers may call it."""
        self._stopping = True

    def learn_now(self) -> None:
        """Learn the target anew in the next frame."""
        self._learn_asked = True

    def emergency(self, action: str) -> None:
        """ "stop" or "release" the robot's emergency stop. Says so when the robot has no control port."""
        try:
            reply = self._link.ask(Request(action=action, text="by the operator"))
        except (LinkLost, ProtocolError) as error:
            log.error("the robot did not confirm the emergency %s: %s", action, error)
            return
        if reply is None:
            log.warning("this robot has no control port: no emergency %s, commands only", action)
        elif not reply.ok:
            log.error("the robot refused the emergency %s: %s", action, reply.error)

    def run(self) -> None:
        """Until `stop`, the duration, or the end of a recording. Sends a stop at the end. Raises StationError."""
        last_frame_s = time.monotonic()
        try:
            while not self._stopping:
                received = self._link.next_frame(WAIT_S)
                if received is not None:
                    last_frame_s = time.monotonic()
                    self._on_step(self._step(*received))
                elif self._link.ended:
                    return
                else:
                    self._wait(time.monotonic() - last_frame_s)
        finally:
            self._link.send(STOP)
            self._let_go_of_head()

    def _wait(self, without_frames_s: float) -> None:
        """No frame came. A run of limited length does not wait for ever for a robot that went."""
        self._on_wait()
        self._forget_keys()
        duration_s = self.settings.duration_s
        if duration_s is not None and without_frames_s > max(duration_s, PATIENCE_S):
            raise StationError(f"No frame for {without_frames_s:.0f} s ({self._link.state}): the run ends here.")

    def _forget_keys(self) -> None:
        """A key pressed while the robot was away must not move it when it is back."""
        while not self._keys.empty():
            self._keys.get_nowait()

    def _step(self, frame: Frame, arrival_s: float) -> Step:
        self._count(frame)
        behaviour = self._behaviour_for(frame)
        learned = self._learn(self._tracker, frame)
        begun_s = time.perf_counter()
        result = self._look(self._tracker, frame)
        tracker_s = time.perf_counter() - begun_s
        angles = self._link.camera_angles(frame)
        command = self._command(behaviour, result, frame, angles)
        if self.settings.rows:  # before the command: in lockstep the next frame may come at once
            self._link.want_rows(self._wanted_rows(), frame.connection)
        sent_s = self._link.send(command, frame.connection)
        self._link.show(self._sight(result), frame.connection)
        self._note_outcome(behaviour)
        return Step(
            frame=frame,
            result=result,
            shadow=self._follow_in_shadow(frame, learned),
            command=command,
            pan_rad=angles[0] if angles is not None else None,
            learned=learned,
            tracker_s=tracker_s,
            frame_to_command_s=None if sent_s is None else sent_s - arrival_s,
        )

    def _wanted_rows(self) -> Rows | None:
        """What serves all trackers; to learn, the whole frame is needed."""
        if self._learn_asked or not self._learned:
            return None
        trackers = [self._tracker] + ([self._shadow] if self._shadow is not None else [])
        return united([_rows_of(tracker) for tracker in trackers])

    def _command(self, behaviour: Behaviour, result: TrackerResult, frame: Frame, angles: Angles | None) -> Command:
        if self._head is not None and angles is not None:
            self._head.pan_rad = angles[0]
        self._driven = self._link.driven(frame)
        command = behaviour.command(result if self._learned else None, frame.time_s)
        if self._head is not None and self._link.hello is not None and self._link.hello.rhythm == "lockstep":
            self._head.settle(LOCKSTEP_LOOK_S)
        return command

    def _sight(self, result: TrackerResult) -> str:
        """What the robot's lights are to tell; a station that does not drive by what it sees is idle."""
        if self.settings.behaviour not in ("follow", "goto"):
            return "idle"
        return SIGHT_OF.get(result.state, "idle")

    def _note_outcome(self, behaviour: Behaviour) -> None:
        """Say once how a journey ended, and end the run with it when that was asked for."""
        outcome = behaviour.outcome if isinstance(behaviour, Journey) else None
        if outcome is not None and outcome != self._outcome:
            log.info("%s", outcome.text)
        self._outcome = outcome
        if outcome is not None and self.settings.until_there:
            self._stopping = True

    def _count(self, frame: Frame) -> None:
        self._frames += 1
        if self._first_s is None:
            self._first_s = frame.time_s
        over = self.settings.duration_s is not None and frame.time_s - self._first_s >= self.settings.duration_s
        if over or self._frames == self.settings.max_frames:
            self._stopping = True

    def _behaviour_for(self, frame: Frame) -> Behaviour:
        """A new one for each connection: the robot may have other limits now, and the past says nothing."""
        if self._behaviour is None or frame.connection != self._connection:
            self._connection = frame.connection
            limits = self._link.hello.limits if self._link.hello is not None else RobotLimits()
            self._let_go_of_head()
            if self.settings.pan:
                self._head = self._take_head()
            scenario = self._link.hello.scenario if self._link.hello is not None else None
            context = BehaviourContext(
                drive=Drive(limits),
                keys=self._keys,
                camera=frame.camera,
                head=self._head,
                course=scenario.course if scenario is not None else (),
                where=lambda: self._driven,
            )
            try:
                self._behaviour = make_behaviour(self.settings.behaviour, context)
            except ValueError as error:
                raise StationError(f"--behaviour {self.settings.behaviour}: {error}.", usage=True) from error
        return self._behaviour

    def _take_head(self) -> PanHead:
        hello = self._link.hello
        if hello is None or hello.pan_tilt is None:
            raise StationError(NO_PAN_TILT, usage=True)
        return PanHead(hello.pan_tilt, self._link.control_line())

    def _let_go_of_head(self) -> None:
        if self._head is not None:
            self._head.close()
            self._head = None

    def _learn(self, tracker: Tracker, frame: Frame) -> bool:
        """Learn when it is asked for; a view that cannot be learned (a camera that is still dark) is tried again."""
        if not self._learn_asked or not frame.is_whole or not self._choose_target(frame):
            return False
        try:
            tracker.learn(frame, self._target)
        except ValueError as error:
            if str(error) != self._learn_error:
                log.warning("cannot learn this target: %s", error)
            self._learn_error = str(error)
            return False
        self._learn_asked, self._learned, self._learn_error = False, True, ""
        if self.settings.scale is not None:
            self._scale = self.settings.scale(self._target, frame.camera)
        return True

    def _choose_target(self, frame: Frame) -> bool:
        """Fix the box to learn: the user's, else the simulated operator's, else the whole view. False: not yet."""
        event = next((event for event in self._link.events if event.kind == "learn"), None)
        if self.settings.target is None and not self._learned and event is not None:
            if frame.number < event.frame:
                return False
            self._target = Box(*event.box) if event.box is not None else None
        if self._target is not None and self.settings.target_rows is not None:
            self._target = self._target.with_rows(self.settings.target_rows)
        return True

    def _look(self, tracker: Tracker, frame: Frame) -> TrackerResult:
        if self._learn_error and not self._learned:
            return TrackerResult(state=TrackingState.INITIALIZING, reason=self._learn_error)
        result = _checked(tracker, tracker.update(frame))
        return self._scale.measured(result) if self._scale is not None else result

    def _follow_in_shadow(self, frame: Frame, learned: bool) -> TrackerResult | None:
        if self._shadow is None:
            return None
        if learned:
            try:
                self._shadow.learn(frame, self._target)
            except ValueError as error:
                return TrackerResult(state=TrackingState.INITIALIZING, reason=str(error))
        return _checked(self._shadow, self._shadow.update(frame))


def _rows_of(tracker: Tracker) -> Rows | None:
    """The rows that this tracker wants."""
    rows: object = tracker.wanted_rows() if isinstance(tracker, WantsRows) else None
    if rows is None:
        return None
    if not isinstance(rows, tuple) or len(rows) != 2 or not all(isinstance(row, int) for row in rows):
        kind = type(tracker).__name__
        raise StationError(f"Stopped the robot: {kind}.wanted_rows returned {rows!r:.60}, not two whole rows or None.")
    return rows


def _checked(tracker: Tracker, result: object) -> TrackerResult:
    """A tracker of the user's own may return anything."""
    if not isinstance(result, TrackerResult):
        kind = type(tracker).__name__
        raise StationError(f"Stopped the robot: {kind}.update returned {type(result).__name__}, not a TrackerResult.")
    return result
