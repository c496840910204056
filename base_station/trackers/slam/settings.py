"""The settings of all stages in one value."""

from __future__ import annotations

from dataclasses import dataclass, field

from base_station.trackers.slam.culling import CullingSettings
from base_station.trackers.slam.features import FeatureSettings
from base_station.trackers.slam.initialization import InitializerSettings
from base_station.trackers.slam.keyframe_decision import KeyframeSettings
from base_station.trackers.slam.local_bundle import BundleSettings
from base_station.trackers.slam.new_points import NewPointSettings
from base_station.trackers.slam.tracking import TrackingSettings


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
