"""The simulated camera shows what is there, at the right time, with the faults that were asked for."""

import math
import threading

import cv2
import numpy as np
import pytest

from robot_agent.cameras.sim import SimCamera
from robot_agent.errors import CameraError
from robot_agent.sim.faults import Faults
from robot_agent.sim.world import World

SMALL = {"width": 160, "height": 120}
SILENT = Faults(noise_sigma=0.0)
PLAIN_GRAYS = (128, 135, 150, 214, 237)
"""Floor, screen, walls, ceiling and the leader's body in `plain`, in full light."""


class FakeClock:
    """Wall-clock time that passes only in sleeps."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.on_sleep = lambda: None

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        assert duration_s > 0.0
        self.on_sleep()
        self.now_s += duration_s


def lockstep(world: World) -> SimCamera:
    return SimCamera(world, realtime=False)


def realtime(world: World, clock: FakeClock) -> SimCamera:
    return SimCamera(world, clock=clock, sleep=clock.sleep)


def see_picture(image: np.ndarray, focal_px: float) -> tuple[float, float]:
    """Bearing and range of the 15 cm picture from a noiseless `plain` image, by its left and right edges alone: it
    stands upright, its middle as high as the camera, so each edge's height above the horizon tells its depth."""
    rows, columns = image.shape
    unlike = np.min([np.abs(image.astype(int) - gray) for gray in PLAIN_GRAYS], axis=0) > 2
    near_horizon = unlike[rows // 2 - 40 : rows // 2]
    left = np.median([np.flatnonzero(row)[0] for row in near_horizon]) - 0.5
    right = np.median([np.flatnonzero(row)[-1] for row in near_horizon]) + 0.5
    depths = []
    for edge in (math.ceil(left), math.floor(right)):
        strip = unlike[: rows // 2, max(0, edge - 2) : edge + 3].any(axis=1)
        top = np.flatnonzero(strip)[0] - 0.5
        depths.append(focal_px * 0.075 / ((rows - 1) / 2 - top))
    ends = [(edge - (columns - 1) / 2) / focal_px * depth for edge, depth in zip((left, right), depths, strict=True)]
    x, z = sum(ends) / 2, sum(depths) / 2
    return math.atan2(-x, z), math.hypot(x, z)


@pytest.mark.parametrize("wheels", [(0, 0), (25, -25), (-25, 25), (-120, -100), (150, 120), (-15, 20)])
def test_truth_agrees_with_what_the_image_shows(wheels):
    world = World(scenario="plain", seed=2, faults=SILENT)
    world.set_wheels(*wheels)
    if wheels != (0, 0):
        world.start()
    for _ in range(4):
        world.advance(0.5)
        frame = world.capture()
        bearing, range_m = see_picture(frame.image, world.intrinsics.fx)
        assert frame.truth.in_view
        assert math.degrees(bearing - frame.truth.bearing_rad) == pytest.approx(0.0, abs=0.1)
        assert range_m == pytest.approx(frame.truth.range_m, rel=0.01)


def test_the_picture_that_leaves_the_frame_is_not_in_view():
    world = World(scenario="plain", seed=2, faults=SILENT)
    world.set_wheels(50, -50)
    seen = {True: 0, False: 0}
    for _ in range(12):
        world.advance(0.125)
        frame = world.capture()
        outside = np.abs(np.degrees(frame.truth.bearing_rad)) + math.degrees(math.atan(0.075 / 0.4)) > 31.5
        inside = np.abs(np.degrees(frame.truth.bearing_rad)) + math.degrees(math.atan(0.075 / 0.4)) < 29.0
        if outside or inside:
            assert frame.truth.in_view == inside
            seen[bool(inside)] += 1
    assert min(seen.values()) >= 2


@pytest.mark.parametrize(("scenario", "share"), [("leader", 0.94), ("poster", 0.94), ("plain", 0.94)])
def test_the_learn_box_lies_a_little_inside_the_picture(scenario, share):
    world = World(scenario=scenario, seed=1, faults=SILENT)
    event = world.scenario.events[0]
    assert (event.kind, event.frame) == ("learn", 1)
    x, y, width, height = event.box
    truth = lockstep(world).read(1.0).truth
    side_m = 0.22 if scenario == "poster" else 0.15
    assert width == height == pytest.approx(share * side_m * world.intrinsics.fx / truth.range_m, abs=1.5)
    assert x + (width - 1) / 2 == pytest.approx(world.intrinsics.cx, abs=0.6)
    assert x >= 0 and x + width <= 640 and y >= 0 and y + height <= 480


def test_the_learn_box_frames_the_pixels_of_the_picture():
    world = World(scenario="plain", seed=4, faults=SILENT)
    image = lockstep(world).read(1.0).image.astype(int)
    unlike = np.min([np.abs(image - gray) for gray in PLAIN_GRAYS], axis=0) > 2
    x, y, width, height = (int(value) for value in world.scenario.events[0].box)
    assert unlike[y : y + height, x : x + width].mean() > 0.8
    rows, columns = np.flatnonzero(unlike.sum(axis=1) > 100), np.flatnonzero(unlike[:330].sum(axis=0) > 100)
    margins = (x - columns[0], columns[-1] - (x + width - 1), y - rows[0], rows[-1] - (y + height - 1))
    assert all(4 <= margin <= 8 for margin in margins), margins


def test_turning_left_moves_the_view_to_the_right():
    world = World(scenario="turn", seed=0, faults=SILENT)
    first = lockstep(world).read(1.0).image
    world.start()
    world.advance(3.0)
    second = world.capture()
    (shift, _), _ = cv2.phaseCorrelate(first[40:200].astype(np.float32), second.image[40:200].astype(np.float32))
    expected_px = -math.tan(second.truth.bearing_rad) * world.intrinsics.fx
    assert abs(expected_px) > 10
    assert shift == pytest.approx(expected_px, abs=0.15 * abs(expected_px))


def test_lockstep_advances_one_period_a_read_and_the_first_by_none():
    world = World(scenario="plain", seed=0, **SMALL)
    camera = lockstep(world)
    times = [camera.read(1.0).capture_s for _ in range(7)]
    assert times == pytest.approx([k / 30.0 for k in range(7)], abs=1e-9)
    assert world.truth().robot == world.capture().truth.robot


def drive(seed: int, faults: Faults) -> list:
    world = World(scenario="leader", seed=seed, width=320, height=240, faults=faults)
    camera = lockstep(world)
    camera.begin()
    frames = []
    for k in range(16):
        frames.append(camera.read(1.0))
        world.set_wheels(100 + 5 * k, 150 - 3 * k)
    return frames


def test_the_same_seed_and_commands_give_the_same_pictures_and_truth():
    for one, two in zip(drive(7, Faults.standard()), drive(7, Faults.standard()), strict=True):
        assert np.array_equal(one.image, two.image)
        assert (one.capture_s, one.truth) == (two.capture_s, two.truth)


def test_another_seed_gives_another_world():
    one, two = (World(scenario="leader", seed=seed, faults=SILENT, **SMALL).capture() for seed in (7, 8))
    assert one.truth.robot != two.truth.robot
    assert np.abs(one.image.astype(int) - two.image).mean() > 20


def test_one_fault_leaves_the_luck_of_the_others_alone():
    calm, noisy = drive(7, SILENT)[-1], drive(7, Faults(noise_sigma=8.0))[-1]
    assert calm.truth == noisy.truth
    difference = (noisy.image.astype(float) - calm.image)[(calm.image > 40) & (calm.image < 215)]
    assert difference.std() == pytest.approx(8.0, rel=0.03)


def test_the_share_of_lost_frames_is_the_one_asked_for():
    world = World(scenario="plain", seed=0, faults=Faults(lost_frames=0.2), **SMALL)
    camera = lockstep(world)
    steps = np.diff([camera.read(1.0).capture_s for _ in range(300)]) * 30.0
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    assert 1.0 - 1.0 / steps.mean() == pytest.approx(0.2, abs=0.06)


def test_blur_is_the_mean_over_the_exposure_and_the_stamp_its_middle():
    sharp = World(scenario="turn", seed=0, width=320, height=240, faults=SILENT)
    blurred = World(scenario="turn", seed=0, width=320, height=240, faults=Faults(noise_sigma=0.0, blur_s=0.030))
    camera = lockstep(blurred)
    camera.begin()
    sharp.start()
    frames = [camera.read(1.0) for _ in range(91)]
    moments = [3.0 - before_s for before_s in (*blurred.exposure_times_s, 0.0)]
    assert len(moments) >= 3 and moments[-1] - moments[0] == pytest.approx(0.030, abs=0.003)
    views = []
    for moment in moments:
        sharp.advance_to(moment)
        views.append(sharp.capture())
    expected = np.mean([view.image.astype(float) for view in views], axis=0)
    assert np.abs(frames[-1].image - expected).mean() < 0.6
    middle = views[len(views) // 2]
    assert frames[-1].capture_s == pytest.approx(middle.capture_s, abs=1e-9)
    assert frames[-1].truth == middle.truth
    edges = [cv2.Laplacian(image, cv2.CV_32F).var() for image in (frames[-1].image, middle.image)]
    assert edges[0] < 0.85 * edges[1]


def test_the_light_of_lights_dims_the_picture():
    world = World(scenario="lights", seed=0, faults=SILENT, **SMALL)
    bright = world.capture().image.astype(float)
    world.start()
    world.advance(0.9)
    assert np.abs(world.capture().image - bright).mean() < 0.1
    world.set_wheels(-400, -400)
    world.advance(5.0)
    dark = world.capture().image
    assert dark.max() <= 82
    assert dark.mean() == pytest.approx(bright.mean() / 3.0, rel=0.15)


def test_in_real_time_thirty_frames_take_a_second_and_commands_act_at_once():
    world, clock = World(scenario="plain", seed=0, **SMALL), FakeClock()
    camera, behind = realtime(world, clock), []
    clock.on_sleep = lambda: behind.append(clock.now_s - 1000.0 - world.time_s)
    stamps = [camera.read(1.0).capture_s for _ in range(31)]
    assert clock.now_s - 1000.0 == pytest.approx(1.0, abs=0.005)
    assert np.diff(stamps) == pytest.approx(1.0 / 30.0, abs=1e-6)
    assert min(behind) >= -1e-6 and max(behind) < 0.005


def test_a_slow_machine_loses_ground_instead_of_building_a_backlog():
    world, clock = World(scenario="plain", seed=0, **SMALL), FakeClock()
    camera = realtime(world, clock)
    camera.read(1.0)
    for _ in range(5):
        clock.now_s += 1.0
        before = world.time_s
        camera.read(1.0)
        assert world.time_s - before == pytest.approx(1.0 / 30.0, abs=0.003)
    slept, clock.on_sleep = [], lambda: slept.append(world.time_s)
    before = world.time_s
    for _ in range(10):
        camera.read(1.0)
    assert slept and slept[0] - before <= 0.1 + 0.005, "it has caught up"


def test_a_read_that_times_out_goes_on_with_the_same_frame():
    world, clock = World(scenario="plain", seed=0, faults=Faults(blur_s=0.030), **SMALL), FakeClock()
    camera = realtime(world, clock)
    frames = [camera.read(0.010) for _ in range(40)]
    stamps = [frame.capture_s for frame in frames if frame is not None]
    assert 8 <= len(stamps) < 40
    assert np.diff(stamps)[1:] == pytest.approx(1.0 / 30.0, abs=1e-6)


def test_a_hung_camera_delivers_nothing_while_the_world_goes_on():
    world, clock = World(scenario="plain", seed=0, faults=Faults(camera_hangs_at_s=0.5), **SMALL), FakeClock()
    camera = realtime(world, clock)
    for _ in range(20):
        assert camera.read(0.1) is not None, "the scenario has not begun"
    camera.begin()
    arrived = [camera.read(0.1) for _ in range(40)]
    assert 14 <= sum(frame is not None for frame in arrived) <= 17
    assert arrived[20:] == [None] * 20
    before_s, clock_s = world.time_s, clock.now_s
    assert camera.read(0.5) is None
    assert clock.now_s - clock_s == pytest.approx(0.5, abs=1e-6)
    assert world.time_s - before_s == pytest.approx(0.5, abs=0.01)


def test_in_lockstep_a_hung_camera_stops_the_world():
    world, clock = World(scenario="plain", seed=0, faults=Faults(camera_hangs_at_s=0.0), **SMALL), FakeClock()
    camera = SimCamera(world, realtime=False, clock=clock, sleep=clock.sleep)
    camera.begin()
    assert camera.read(0.5) is None
    assert (world.time_s, clock.now_s) == (0.0, 1000.5)


def test_it_draws_in_its_own_thread_and_closes_from_another():
    world = World(scenario="plain", seed=0, **SMALL)
    camera, frames = lockstep(world), []
    thread = threading.Thread(target=lambda: frames.extend(camera.read(1.0) for _ in range(3)))
    thread.start()
    thread.join()
    camera.close()
    assert [frame.image.shape for frame in frames] == [(120, 160)] * 3
    with pytest.raises(CameraError):
        camera.read(1.0)
