"""The settings of all stages in one value."""

from __future__ import annotations

from dataclasses import dataclass, field

from base_station.trackers.slam.culling import CullingSettings
from base_station.trackers.slam.features import FeatureSettings
from base_station.trackers.slam.initialization import InitializerSettings
from base_station.trackers.slam.keyframe_decision import KeyframeSettings
from base_station.trackers.slam.local_bundle import BundleSettings
from base_station.trackers.slam.loop_closing import LoopSettings
from base_station.trackers.slam.new_points import NewPointSettings
from base_station.trackers.slam.relocalization import PlaceSettings
from base_station.trackers.slam.returning import ReturnSettings
from base_station.trackers.slam.tracking import TrackingSettings


@dataclass(frozen=True, kw_only=True)
class AtlasSettings:
    """When a lost map is left for a new one; it is kept, and found again if its places are."""

    near_s: float = 1.0
    """After a loss, for so long it is also looked for around the last picture."""
    new_map_after_s: float = 0.5
    """After so long lost, a new map may begin, with the pictures since the loss. What is lost in a quick turn is not
    seen again soon, and both maps are joined when it is."""
    least_keyframes: int = 5
    """A map with fewer keyframes is forgotten when it is lost."""


@dataclass(frozen=True, kw_only=True)
class SlamSettings:
    """One component each."""

    features: FeatureSettings = field(default_factory=FeatureSettings)
    """What is found in a picture."""
    initializer: InitializerSettings = field(default_factory=InitializerSettings)
    """How a map begins."""
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    """How the camera is followed."""
    keyframes: KeyframeSettings = field(default_factory=KeyframeSettings)
    """Which pictures are kept."""
    new_points: NewPointSettings = field(default_factory=NewPointSettings)
    """How points are made."""
    bundle: BundleSettings = field(default_factory=BundleSettings)
    """How much is adjusted."""
    culling: CullingSettings = field(default_factory=CullingSettings)
    """What is thrown away."""
    places: PlaceSettings = field(default_factory=PlaceSettings)
    """How places are recognised."""
    loops: LoopSettings = field(default_factory=LoopSettings)
    """When two places are one."""
    returns: ReturnSettings = field(default_factory=ReturnSettings)
    """When a closed loop is confirmed."""
    atlas: AtlasSettings = field(default_factory=AtlasSettings)
    """When a lost map is left for a new one."""
