"""Two maps of one room with a gap between: when the camera comes back to the first, both become one, in one scale."""

from __future__ import annotations

import numpy as np

from base_station.trackers.slam.features import FeatureSettings
from base_station.trackers.slam.sim3 import align, scale_of, transform
from base_station.trackers.slam.system import SlamSettings, SlamSystem
from base_station.types import TrackingState
from tests.base_station.trackers.slam.room import Room, small_camera, standing

CAMERA = small_camera()
ROOM = Room(CAMERA)
FRAME_S = 1 / 30


def aside(start_deg: float, end_deg: float, count: int) -> list[np.ndarray]:
    """Round a circle of 1 m, looking outwards, up and down a little."""
    angles = np.radians(np.linspace(start_deg, end_deg, count))
    return [standing(np.sin(a), np.cos(a), a + 0.6, 0.1 * np.sin(3 * a)) for a in angles]


def test_two_maps_become_one_where_they_meet():
    first, second = aside(0, 110, 45), aside(190, 430, 98)
    settings = SlamSettings(features=FeatureSettings(count=700))
    with SlamSystem(CAMERA, settings=settings, single_process=True) as slam:
        shown: dict[float, np.ndarray] = {}
        time_s, components = 0.0, []
        for pose in [*first, *[None] * 60, *second]:
            picture = np.zeros((240, 320), np.uint8) if pose is None else ROOM.picture(pose)
            frame = slam.track(picture, time_s)
            assert pose is not None or frame.state is not TrackingState.TRACKING
            if pose is not None:
                shown[time_s] = pose
            components.append(frame.component)
            time_s += FRAME_S
        slam.finish()
        counts = slam.statistics()
        assert set(components[: len(first)]) == {-1, 0}
        assert 1 in components  # on its own, at first
        assert components[-1] == 0  # and then in the older one's frame
        assert (counts.maps, counts.merges) == (1, 1)
        assert [closure.kind for closure in counts.closures][:1] == ["merge"]
        trajectory = slam.trajectory()
        found = np.array([pose[:3, 3] for _, pose in trajectory])
        truth = np.array([shown[at_s][:3, 3] for at_s, _ in trajectory])
        early = np.array([at_s < len(first) * FRAME_S for at_s, _ in trajectory])
        assert early.sum() > 25 and (~early).sum() > 50
        whole, one, two = align(found, truth), align(found[early], truth[early]), align(found[~early], truth[~early])
        assert np.linalg.norm(transform(whole, found) - truth, axis=1).max() < 0.25
        assert 0.93 < scale_of(one) / scale_of(two) < 1.07
        world = slam.map
        alive = world.points_alive()
        assert set(world.point_component[alive]) == set(world.component[world.keyframes_alive()]) == {0}
        walls = np.array([5.0, 3.0, 5.0]) / 2
        off = np.min(np.abs(np.abs(transform(to_room(whole), world.xyz[alive])) - walls), axis=1)
        assert np.median(off) < 0.08  # the points of both lie on the room's walls


def to_room(world_from_map: np.ndarray) -> np.ndarray:
    """The room's own coordinates are those of the truth."""
    return world_from_map
