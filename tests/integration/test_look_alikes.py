"""The tracker in the cluttered room, frame by frame: while its target is hidden it takes no look-alike for it."""

from __future__ import annotations

import numpy as np

from base_station.geometry import PinholeCamera
from base_station.trackers.registry import make_tracker
from base_station.types import Box, Frame, TrackingState
from robot_agent.sim.world import World

WIDTH, HEIGHT = 320, 240
PROVEN, HIDDEN = 65, 30


def test_none_of_the_pictures_around_it_is_taken_for_the_hidden_target():
    """Mirrored, with its quarters exchanged and smaller, all in view: LOST for a second; then the right one again."""
    world = World(scenario="clutter", seed=0, width=WIDTH, height=HEIGHT)
    views = [world.capture().image for _ in range(5)]
    box = Box(*world.scenario.events[0].box)
    world.close()
    hidden = [view.copy() for view in views]
    rng, edge = np.random.default_rng(0), 4
    left, top, width, height = (round(side) for side in (box.x, box.y, box.width, box.height))
    for view in hidden:
        patch = view[top - edge : top + height + edge, left - edge : left + width + edge]
        patch[:] = rng.normal(140, 3, patch.shape).round()
    camera, tracker = PinholeCamera.with_fov(WIDTH, HEIGHT), make_tracker("ztransform")

    def frame(images: list[np.ndarray], number: int) -> Frame:
        return Frame(image=images[number % len(images)], number=number, time_s=number / 30, camera=camera)

    tracker.learn(frame(views, 1), box)
    for number in range(2, PROVEN):
        assert tracker.update(frame(views, number)).state is TrackingState.TRACKING
    for number in range(PROVEN, PROVEN + HIDDEN):
        result = tracker.update(frame(hidden, number))
        assert result.state is TrackingState.LOST, (number, result)
    results = [tracker.update(frame(views, number)) for number in range(PROVEN + HIDDEN, PROVEN + HIDDEN + 3)]
    assert results[-1].state is TrackingState.TRACKING
    assert abs(results[-1].shift_px) < 1 and abs(results[-1].zoom - 1) < 0.02
