"""The simulated world: a stage of a scenario, brought to life by the physics engine and seen by a faulty camera.

Time advances only when asked to, so one world serves real time and lockstep, and the same calls give the same pictures.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

import cv2
import numpy as np

from protocol import PanTiltLimits, RobotLimits, Scenario, Truth
from robot_agent.cameras.base import CameraFrame
from robot_agent.errors import CameraError
from robot_agent.pantilt.slew import SERVO_LAG_S, Slew
from robot_agent.robots.base import RobotState
from robot_agent.sim import thymio
from robot_agent.sim.faults import Faults
from robot_agent.sim.scene import Scene
from robot_agent.sim.slip import WheelSlip

_SAME_TIME_S = 1e-6
_SENSING_PERIOD_S = 0.010
_EPISODE_GAP_S = 0.2
"""Contacts closer together than this are one collision: a body that scrapes along bounces."""
_EXPOSURES = 3
"""Pictures averaged for one blurred frame; odd, so that one of them is the middle."""


@dataclass(frozen=True, kw_only=True)
class _Exposure:
    image: np.ndarray
    time_s: float
    light: float
    truth: Truth


class World:
    """A robot in a scenario. All methods may be called from any thread, but `expose` and `capture` from one only."""

    def __init__(
        self,
        *,
        scenario: str,
        seed: int,
        width: int = 640,
        height: int = 480,
        fps: float = 30.0,
        faults: Faults | None = None,
        pan_tilt: PanTiltLimits | None = None,
    ) -> None:
        """`pan_tilt`: put the camera on one; None: it is fixed.

        Raises AgentError for an unknown scenario (listing the valid ones), a negative seed, or without MuJoCo.
        """
        self.width, self.height, self.fps = width, height, fps
        self.faults = faults or Faults()
        self.limits: RobotLimits = thymio.LIMITS
        self.pan_tilt = pan_tilt
        self._scene = Scene(
            scenario=scenario,
            seed=seed,
            width=width,
            height=height,
            fps=fps,
            noise_sigma=self.faults.noise_sigma,
            pan_tilt=pan_tilt is not None,
        )
        self._slew = Slew(pan_tilt) if pan_tilt is not None else None
        self.intrinsics = self._scene.intrinsics
        self.scenario: Scenario = self._scene.announcement
        self._stage, self._engine, self._step_s = self._scene.stage, self._scene.engine, self._scene.step_s
        self._slip = WheelSlip(mean=self.faults.wheel_slip, step_s=self._step_s, seed=self._scene.slip_seed)
        self._losses = np.random.default_rng(self._scene.loss_seed)
        self._lock = threading.RLock()
        self._drawing = threading.Lock()
        self._steps = 0
        self._asked_s = 0.0
        self._started_s: float | None = None
        self._wheels = (0, 0)
        self._held = self._stage.held(0.0) is not None
        self._collisions = 0
        self._last_touch_s = -math.inf
        self._sensed_s = -math.inf
        self._proximity: tuple[int, ...] = ()
        self._exposures: list[_Exposure] = []
        self._closed = False
        self._truth = self._scene.truth(collisions=0)

    @property
    def time_s(self) -> float:
        """Simulated time since the world was made."""
        with self._lock:
            return self._steps * self._step_s

    @property
    def exposure_times_s(self) -> tuple[float, ...]:
        """How long before each frame `expose` is due; the last moment is that of `capture` itself."""
        if self.faults.blur_s == 0.0:
            return ()
        between = round(self.faults.blur_s / (_EXPOSURES - 1) / self._step_s)
        return tuple(k * between * self._step_s for k in range(_EXPOSURES - 1, 0, -1))

    @property
    def camera_hangs(self) -> bool:
        """Whether the camera has stopped for good, by fault."""
        with self._lock:
            at_s = self.faults.camera_hangs_at_s
            return at_s is not None and self._started_s is not None and self._scenario_s() >= at_s

    def start(self) -> None:
        """Let the scenario begin: the leader drives off, the light changes. Later calls do nothing."""
        with self._lock:
            if self._started_s is None:
                self._started_s = self.time_s

    def set_wheels(self, left: int, right: int) -> None:
        """Motor units, clamped to the robot's limit; they act from the next step on."""
        limit = self.limits.max_units
        with self._lock:
            self._wheels = (max(-limit, min(limit, left)), max(-limit, min(limit, right)))

    def look(self, pan_rad: float, tilt_rad: float) -> None:
        """Turn the camera there from now on. Raises ValueError when it is fixed, or an angle is not finite."""
        with self._lock:
            if self._slew is None:
                raise ValueError("this world's camera is fixed")
            self._slew.look(self.time_s, pan_rad, tilt_rad)

    def looked_at(self, time_s: float) -> tuple[float, float]:
        """Pan and tilt at a simulated time, as far as one can know without asking the joints."""
        with self._lock:
            return self._slew.at(time_s - SERVO_LAG_S) if self._slew is not None else (0.0, 0.0)

    def advance(self, duration_s: float) -> None:
        """Let so much time pass, in whole steps (what is left over counts next time)."""
        with self._lock:
            self.advance_to(self._asked_s + duration_s)

    def advance_to(self, time_s: float) -> None:
        """Let time pass up to `time_s`, in whole steps. A time that has passed already does nothing."""
        with self._lock:
            self._asked_s = max(self._asked_s, time_s)
            while (self._steps + 1) * self._step_s <= self._asked_s + _SAME_TIME_S:
                self._step()

    def state(self) -> RobotState:
        """Proximity (at most 10 ms of simulated time old) and the wheels' own idea of their speed."""
        with self._lock:
            if not self._proximity or self.time_s - self._sensed_s >= _SENSING_PERIOD_S:
                self._engine.refresh()
                self._proximity = tuple(thymio.proximity_value(distance_m) for distance_m in self._engine.sense())
                self._sensed_s = self.time_s
            speeds = zip(self._engine.wheel_speeds_rad_s, self._slip.kept, strict=True)
            left, right = (round(speed / kept / thymio.RADIANS_PER_UNIT_S) for speed, kept in speeds)
            return RobotState(proximity=self._proximity, wheels_measured=(left, right))

    def truth(self) -> Truth:
        """Where things were when the newest frame was taken."""
        with self._lock:
            return self._truth

    def expose(self) -> None:
        """Gather light for the next frame. Raises CameraError after `close`."""
        with self._drawing:
            with self._lock:
                if self._closed:
                    raise CameraError("The simulated camera is closed; start the agent again.")
                self._scene.move_background(self._scenario_s())
                self._engine.refresh()
                self._engine.aim()
                time_s, light = self.time_s, self._stage.light(self._scenario_s())
                truth = self._scene.truth(self._collisions)
            # Drawing takes milliseconds; wheel commands must not wait for it.
            image = self._engine.draw()
            self._exposures.append(_Exposure(image=image, time_s=time_s, light=light, truth=truth))

    def capture(self) -> CameraFrame | None:
        """The frame whose exposure ends now, stamped with the exposure's middle; None when it is lost by fault."""
        if self._losses.random() < self.faults.lost_frames:
            self._exposures.clear()
            return None
        self.expose()
        exposures, self._exposures = self._exposures, []
        middle = exposures[len(exposures) // 2]
        with self._lock:
            self._truth = middle.truth
        image = self._scene.noisy(_developed(exposures))
        return CameraFrame(image=image, capture_s=middle.time_s, truth=middle.truth)

    def close(self) -> None:
        """Free the drawing resources. No frame comes after this."""
        with self._drawing, self._lock:
            self._closed = True
            self._engine.close()

    def _scenario_s(self) -> float:
        return 0.0 if self._started_s is None else self.time_s - self._started_s

    def _step(self) -> None:
        self._steps += 1  # actors are placed for the end of the step
        now_s = self._scenario_s()
        self._place_leader(now_s)
        held = self._stage.held(now_s)
        if self._held and held is None and self._stage.set_down is not None:
            self._engine.place_robot(self._stage.set_down)
        self._held = held is not None
        self._slip.step()
        asked = (0, 0) if self._held else self._wheels
        left, right = (
            units * kept * thymio.RADIANS_PER_UNIT_S for units, kept in zip(asked, self._slip.kept, strict=True)
        )
        self._engine.drive(left, right)
        if self._slew is not None:
            self._engine.turn_camera(*self._slew.at(self.time_s))
        self._engine.step()
        if held is not None:
            self._engine.place_robot(held)
        elif self._engine.is_touching:
            self._collisions += self.time_s - self._last_touch_s > _EPISODE_GAP_S
            self._last_touch_s = self.time_s

    def _place_leader(self, scenario_s: float) -> None:
        if self._stage.leader is not None:
            self._engine.place_leader(self._stage.leader(scenario_s))


def _developed(exposures: list[_Exposure]) -> np.ndarray:
    """The mean of the exposures, each in its own light: uint8 (height, width)."""
    if len(exposures) == 1:
        only = exposures[0]
        return only.image if only.light == 1.0 else cv2.convertScaleAbs(only.image, alpha=only.light)
    total = np.zeros(exposures[0].image.shape, np.float32)
    for exposure in exposures:
        cv2.scaleAdd(exposure.image.astype(np.float32), exposure.light / len(exposures), total, dst=total)
    return cv2.convertScaleAbs(total)
