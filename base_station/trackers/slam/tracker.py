"""SLAM as a tracker: a target is remembered in the map, and its bearing and zoom follow from the camera's pose.

A monocular map needs some centimetres of motion before it exists, and a target is wanted at once. Until the map knows
the target, and whenever it is lost, the learned picture's features are looked for in the picture itself. When they are
not in it either, the tracker says so; the heading it keeps all the same, by a compass that needs no map.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from base_station.trackers.base import MapView, Shown, Survey
from base_station.trackers.baselines.patch import Found, Learned, Missed, PatchTracker
from base_station.trackers.baselines.similarity import LEAST_INLIERS
from base_station.trackers.slam import libraries
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.compass import ZCompass
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.lens import Lens, through
from base_station.trackers.slam.map_file import leave_map, take_up_map
from base_station.trackers.slam.matching import match_everywhere
from base_station.trackers.slam.placement import Placement
from base_station.trackers.slam.rehearsal import rehearse_tracking
from base_station.trackers.slam.saved_map import SavedMap
from base_station.trackers.slam.se3 import camera_centers, inverse
from base_station.trackers.slam.sighting import sight
from base_station.trackers.slam.system import SlamSettings, SlamSystem
from base_station.trackers.slam.target import heading_of, result_of
from base_station.types import Box, Frame, TrackerResult, TrackingState

log = logging.getLogger(__name__)

SURE_MATCHES = 150
"""Map points seen, from which on a pose could not be surer."""
NEARLY_AHEAD_RAD = math.radians(4.0)
"""A learned view that lies so near to the optical axis sets the compass."""


def _turned_by(place: TrackerResult, heading_rad: float, frame: Frame) -> TrackerResult:
    """A learned place, seen in the picture only: its bearing by the compass, which knows a turn's perspective."""
    if abs(heading_rad) >= math.pi / 3:
        return place
    shift_px = -frame.camera.fx * math.tan(heading_rad)
    return replace(place, bearing_rad=heading_rad, shift_px=shift_px)


class SlamTracker(PatchTracker):
    """See `base.Tracker`. The map outlives `learn`: only a camera of another kind begins a new one.

    `single_process`: the mapper works within `update`, which then takes longer; for tests and replays. `map_file`: the
    map of an earlier run, taken up where there is one, and where `keep_map` leaves this one's. `say` gets a line of
    each.
    """

    def __init__(
        self,
        *,
        settings: SlamSettings | None = None,
        single_process: bool = False,
        map_file: Path | None = None,
        say: Callable[[str], None] = log.info,
    ) -> None:
        """Raises StationError when pycolmap or gtsam is missing, or the file holds no map. Compiles what needs it, and
        reads the map, now: later a robot waits."""
        super().__init__()
        libraries.gtsam()
        rehearse_tracking()
        self._settings, self._single_process = settings, single_process
        self._map_file, self._say = map_file, say
        self._saved = self._read_map()
        self._kept = False
        """Since the last picture."""
        self._slam: SlamSystem | None = None
        self._camera: SlamCamera | None = None
        self._extract: Callable[[np.ndarray], Features]
        self._shown_at: Callable[[np.ndarray], np.ndarray]
        self._learning: tuple[float, SlamCamera]
        """When, and with which camera, the picture was taken that is being learned."""
        self._placement: Placement | None = None
        self._lens = Lens()
        """That the learned corners are free of, see `Map.lens`."""
        self._compass = ZCompass()
        self._pose: np.ndarray | None = None

    def _read_map(self) -> SavedMap | None:
        if self._map_file is None:
            return None
        if not self._map_file.exists():
            self._say(f"map: a new one, {self._map_file} is written at the end")
            return None
        saved = take_up_map(self._map_file, self._say)
        _ = saved.words  # computed once, and kept
        return saved

    @property
    def slam(self) -> SlamSystem | None:
        """The system beneath, once something has been learned."""
        return self._slam

    def learn(self, frame: Frame, target: Box | None) -> None:
        """Remember the target. Raises ValueError as `base.Tracker.learn` does, StationError when the map is of another
        camera."""
        camera = SlamCamera.of(frame.camera)
        if frame.image.shape != (camera.height_px, camera.width_px):
            raise ValueError("the frame has another size than its camera")
        slam = self._slam
        if slam is None or camera != self._camera:
            mapped = slam.saved() if slam is not None and self._map_file is not None else None
            slam = SlamSystem(
                camera, settings=self._settings, single_process=self._single_process, mapper_at_once=False,
                saved=mapped or self._saved,
            )  # fmt: skip
        self._extract, self._shown_at = slam.features_of, camera.distort
        self._learning = frame.time_s, camera
        try:
            super().learn(frame, target)
        except ValueError:
            if slam is not self._slam:
                slam.close()
            raise
        if slam is not self._slam:
            self._end_mapper()
            self._slam, self._camera = slam, camera
        self._lens = Lens(*slam.map.lens)
        self._compass.start(frame, 0.0)

    def _prepare(self, image: np.ndarray, patch: np.ndarray, learned: Learned) -> None:
        features = self._extract(image)
        half_px = np.array(learned.shape[::-1]) / 2
        in_box = np.all(np.abs(self._shown_at(features.xy_px) - learned.center_px) <= half_px, axis=1)
        if int(in_box.sum()) < LEAST_INLIERS:
            raise ValueError(f"featureless: fewer than {LEAST_INLIERS} ORB corners")
        self._placement = Placement(features, in_box, learned.center_px, *self._learning)

    def update(self, frame: Frame) -> TrackerResult:
        """See `base.Tracker.update`."""
        slam, learned, placement = self._slam, self._learned, self._placement
        if slam is None or learned is None or placement is None:
            return TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned yet")
        seen = slam.track(frame.image, frame.time_s, wait=frame.stepped)
        pose = self._pose = seen.cam_from_world
        self._look_through(Lens(*slam.map.lens), placement)
        self._kept = False
        placement.update(slam, pose)
        if pose is None or placement.target is None:
            result = self._look_at(frame, pose)
            ahead = learned.is_place and result.bearing_rad is not None and abs(result.bearing_rad) < NEARLY_AHEAD_RAD
            return self._with_compass(frame, result, result.bearing_rad if ahead else None)
        if not (placement.is_keyframe or learned.is_place):
            result = self._look_at(frame, pose)
            if result.state is TrackingState.TRACKING:  # what is seen is surer than where it may be in the map
                return self._with_compass(frame, result, None)
        confidence = min(1.0, math.sqrt(seen.matches / SURE_MATCHES))
        result = result_of(placement.target, slam.map, pose, learned, frame.camera, confidence)
        if not placement.is_keyframe:  # its twin would be seen from the other side; which it is, moving will tell
            return replace(result, view_angle_rad=None, compass_rad=self._compass.update(frame))
        return self._with_compass(frame, result, heading_of(placement.target, slam.map, pose))

    def _look_at(self, frame: Frame, pose: np.ndarray | None) -> TrackerResult:
        """The target as the picture itself shows it, and the pose that the map knows."""
        result = super().update(frame)
        return replace(result, cam_from_world=pose) if result.state is TrackingState.TRACKING else result

    def _look_through(self, lens: Lens, placement: Placement) -> None:
        """The learned picture as the map now knows the lens: it was found by adjusting the whole."""
        if lens != self._lens and self._camera is not None:
            placement.look_through(through(placement.features, self._lens, lens, self._camera))
            self._lens = lens

    def _with_compass(self, frame: Frame, result: TrackerResult, heading_rad: float | None) -> TrackerResult:
        """The result with the heading: as the map or the learned view has it, which then sets the compass; else as the
        compass has kept it."""
        kept_rad = self._compass.update(frame)
        if heading_rad is not None:
            off_rad = None if kept_rad is None else math.remainder(kept_rad - heading_rad, 2 * math.pi)
            self._compass.correct(frame, off_rad, heading_rad)
            return replace(result, compass_rad=heading_rad)
        if kept_rad is None:
            return result
        if result.state is TrackingState.TRACKING:
            result = replace(result, compass_rad=kept_rad)
            return _turned_by(result, kept_rad, frame) if self._learned and self._learned.is_place else result
        return replace(result, compass_rad=kept_rad, reason=f"{result.reason}; the compass keeps the heading")

    def _look(self, image: np.ndarray, learned: Learned) -> Found | Missed:
        """In the picture itself, while the map cannot say."""
        picture = None if self._slam is None else self._slam.last_picture
        if self._placement is None or self._camera is None or picture is None:
            return Missed("there is no picture yet")
        if len(picture.features) < LEAST_INLIERS:
            return Missed("the target is hidden or gone (no corners in the picture)")
        mine = self._placement.of_target
        matches = match_everywhere(mine.descriptors, mine.angle_deg, picture.features, most=64, ratio=0.8)
        rows = np.flatnonzero(matches >= 0)
        middle_px = self._camera.undistort(np.array([learned.center_px]))[0]
        found = sight(
            mine.xy_px[rows], picture.features.xy_px[matches[rows]], middle_px, self._camera, flat=not learned.is_place
        )
        if found is None:
            return Missed(f"the target is hidden or gone ({len(rows)} of {len(mine)} corners matched)")
        x, y = self._shown_at(found.middle_px[None])[0].tolist()
        return Found(x=x, y=y, zoom=found.zoom, confidence=found.inliers / len(rows))

    def show(self) -> Shown:
        """See `base.Shows`. The corners that are known points of the map; while there is none, all corners."""
        picture = self._slam.last_picture if self._slam is not None else None
        if picture is None:
            return Shown()
        of_map = picture.point_of >= 0
        xy_px = picture.features.xy_px
        return Shown(features_px=xy_px[of_map] if of_map.any() else xy_px)

    def show_map(self) -> MapView | None:
        """See `base.Maps`. The map in use."""
        slam = self._slam
        if slam is None or slam.component < 0:
            return None
        world, rows = slam.map, slam.map.keyframes_alive(slam.component)
        if not len(rows):
            return None
        return MapView(
            points=world.xyz[world.points_alive(slam.component)],
            keyframes=camera_centers(world.poses[rows]),
            world_from_cam=inverse(self._pose) if self._pose is not None else None,
        )

    def survey(self) -> Survey | None:
        """See `base.Surveyor`."""
        if self._slam is None:
            return None
        self._slam.finish()
        counts = self._slam.statistics()
        return Survey(
            trajectory=self._slam.trajectory(), loops=counts.loops, keyframes=counts.keyframes, maps=counts.maps,
            confirmed=sum(one.kind == "confirmed" for one in counts.closures),
            loop_times_s=tuple(one.time_s for one in counts.closures if one.kind != "merge"),
        )  # fmt: skip

    def keep_map(self) -> None:
        """See `base.KeepsMap`. What is on file stays there as long as nothing is worth keeping."""
        if self._map_file is None or self._slam is None or self._kept:
            return
        self._kept = True
        try:
            self._slam.finish()
        finally:  # with what there is, when the mapper has failed
            leave_map(self._map_file, self._slam.saved(), self._say)

    def _end_mapper(self) -> None:
        if self._slam is not None:
            self._slam.close()
            self._slam = None

    def close(self) -> None:
        """Keep the map, end the mapper and let go of what was learned."""
        try:
            self.keep_map()  # of a tracker that is exchanged; at the end of a run it is kept by now
        finally:
            super().close()
            self._end_mapper()
