"""A visual compass: the heading by the Z-transform's shift, while the map cannot say.

Monocular SLAM has no pose before its first metres, none while it is lost, and can map nothing that is seen only by
turning on the spot. A turn alone shifts the picture, though, and the Z-transform tells the shift of a view that it has
learned. So a view is held, the heading is the view's own plus its bearing, and before the view leaves the picture the
next one is taken from where it is known. Each change costs a little (some hundredths of a degree): the heading drifts,
until SLAM has a pose again and sets it right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from base_station.trackers.ztransform.regression import RegressionSettings
from base_station.trackers.ztransform.rigid import RigidSettings
from base_station.trackers.ztransform.settings import ZTransformSettings
from base_station.trackers.ztransform.tracker import ZTransformTracker
from base_station.types import Frame, TrackerResult, TrackingState


@dataclass(frozen=True, kw_only=True)
class CompassSettings:
    """When the held view is worn out."""

    furthest_rad: float = math.radians(12.0)
    """The view's bearing, at which the next one is taken."""
    least_confidence: float = 0.8
    """The view's resemblance, at which the same happens: the robot drives, or the light changes."""
    largest_zoom: float = 1.1
    """The view's zoom, in or out, at which the same happens."""
    samples: int = 60
    """Disturbances from which a view is learned (see `RegressionSettings`). A tenth of what a target gets: views follow
    each other several times a second, and each is looked at from nearby only."""
    impossible_zoom: float = 1.3
    """The view is seen again so much larger or smaller: the camera was carried, and where to is not told by a shift."""


class ZCompass:
    """Told the heading once, it keeps it from picture to picture.

    A heading here is the direction of the reference (what was straight ahead when a target was learned), from the
    optical axis of now; to the left positive, -pi..pi.
    """

    def __init__(self, settings: CompassSettings | None = None) -> None:
        self._settings = settings or CompassSettings()
        regression = RegressionSettings(samples=self._settings.samples)
        self._view = ZTransformTracker(settings=ZTransformSettings(rigid=RigidSettings(regression=regression)))
        self._view_heading_rad: float | None = None
        """Of the camera that took the held view; None: no view is held."""

    def start(self, frame: Frame, heading_rad: float) -> None:
        """This picture's heading is known: hold it. A picture without texture cannot be held."""
        try:
            self._view.learn(frame, None)
            self._view_heading_rad = heading_rad
        except ValueError:
            self._view_heading_rad = None

    def update(self, frame: Frame) -> float | None:
        """The heading in this picture; None when the held view is not in it, or none is held."""
        if self._view_heading_rad is None:
            return None
        seen = self._view.update(frame)
        if seen.state is not TrackingState.TRACKING or seen.bearing_rad is None:
            return None
        if _off(seen) > math.log(self._settings.impossible_zoom):
            self._view_heading_rad = None
            return None
        heading_rad = math.remainder(self._view_heading_rad + seen.bearing_rad, 2 * math.pi)
        if self._is_worn(seen, seen.bearing_rad):
            self.start(frame, heading_rad)
        return heading_rad

    def correct(self, frame: Frame, error_rad: float | None, heading_rad: float) -> None:
        """One who knows better says the heading in the picture that was just dealt with. `error_rad`: by how much the
        compass was beside it; None when it knew nothing, and a view of now is taken."""
        if error_rad is None or self._view_heading_rad is None:
            self.start(frame, heading_rad)
        else:
            self._view_heading_rad = math.remainder(self._view_heading_rad - error_rad, 2 * math.pi)

    def _is_worn(self, seen: TrackerResult, bearing_rad: float) -> bool:
        settings = self._settings
        return (
            abs(bearing_rad) > settings.furthest_rad
            or seen.confidence < settings.least_confidence
            or _off(seen) > math.log(settings.largest_zoom)
        )


def _off(seen: TrackerResult) -> float:
    """By how much the view is nearer or farther, as a logarithm."""
    return abs(math.log(seen.zoom or 1.0))
