"""Small recorded sequences in each layout, and a stand-in for a SLAM system that knows the path it will be shown."""

from __future__ import annotations

import time

import cv2
import numpy as np

from base_station.evaluation.slam.trajectory import Trajectory, quaternions, write_tum
from base_station.trackers.slam.sim3 import exp, inverse, rotation_matrix
from base_station.trackers.slam.types import SlamFrame, SlamStatistics
from base_station.types import TrackingState

WIDTH, HEIGHT, FRAMES, RATE_HZ = 96, 72, 24, 20.0
BODY_FROM_CAMERA = exp(np.array([0.0, 0.3, 0.1, 0.05, -0.02, 0.1, 0.0]))
STATES = TrackingState
ORBSLAM_YAML = """%YAML:1.0
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: 80.0  # px
Camera1.fy: 81.0
Camera1.cx: 47.0
Camera1.cy: 36.0
Camera1.k1: -0.1
Camera1.k2: 0.01
Camera1.p1: 0.0
Camera1.p2: 0.0
Camera.width: 96
Camera.height: 72
"""


def pose_at(time_s):
    """world_from_cam: along x at constant speed, turning a little."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_matrix(np.array([0.0, 0.2 * time_s, 0.05 * np.sin(time_s)]))
    pose[:3, 3] = 0.5 * time_s, 0.1 * np.sin(3 * time_s), 0.2 * time_s**2
    return pose


def path(count=FRAMES, begin_s=0.0):
    times = begin_s + np.arange(count) / RATE_HZ
    return Trajectory(times, np.stack([pose_at(time_s - begin_s) for time_s in times]))


def _pictures(folder, names):
    folder.mkdir(parents=True)
    for number, name in enumerate(names):
        image = np.full((HEIGHT, WIDTH), 5 * number % 256, np.uint8)
        cv2.imwrite(str(folder / name), image)


def write_tum_sequence(folder, count=FRAMES, yaml=ORBSLAM_YAML):
    truth = path(count, begin_s=100.0)
    names = [f"{time_s:.6f}.png" for time_s in truth.times_s]
    _pictures(folder / "rgb", names)
    lines = [f"{time_s:.6f} rgb/{name}" for time_s, name in zip(truth.times_s, names, strict=True)]
    (folder / "rgb.txt").write_text("# timestamp filename\n" + "\n".join(lines) + "\n")
    write_tum(folder / "groundtruth.txt", truth)
    if yaml is not None:
        (folder / "orbslam3.yaml").write_text(yaml)
    return folder


def write_euroc_sequence(folder, count=FRAMES):
    """The ground truth is the body's, at ten times the rate."""
    truth, cam0 = path(count, begin_s=1403636579.0), folder / "mav0" / "cam0"
    stamps = [round(time_s * 1e9) for time_s in truth.times_s]
    _pictures(cam0 / "data", [f"{stamp}.png" for stamp in stamps])
    rows = "\n".join(f"{stamp},{stamp}.png" for stamp in stamps)
    (cam0 / "data.csv").write_text(f"#timestamp [ns],filename\n{rows}\n")
    (cam0 / "sensor.yaml").write_text(
        "#Default imu sensor yaml file\nsensor_type: camera\ncomment: VI-Sensor cam0\n\nT_BS:\n  cols: 4\n  rows: 4\n"
        "  data: [" + ",\n         ".join(", ".join(map(str, row)) for row in BODY_FROM_CAMERA.tolist()) + "]\n"
        f"\nrate_hz: 20\nresolution: [{WIDTH}, {HEIGHT}]\ncamera_model: pinhole\n"
        "intrinsics: [80.0, 81.0, 47.0, 36.0] #fu, fv, cu, cv\ndistortion_model: radial-tangential\n"
        "distortion_coefficients: [-0.28, 0.07, 0.00019, 1.76e-05]\n"
    )
    fine = 1403636579.0 + np.arange(10 * count) / RATE_HZ / 10
    body = np.stack([pose_at(time_s - 1403636579.0) for time_s in fine]) @ inverse(BODY_FROM_CAMERA)
    turns = quaternions(body[:, :3, :3])[:, [3, 0, 1, 2]]
    rows = [
        f"{round(time_s * 1e9)}," + ",".join(f"{value:.9f}" for value in (*pose[:3, 3], *turn)) + ",0,0,0"
        for time_s, pose, turn in zip(fine, body, turns, strict=True)
    ]
    state = folder / "mav0" / "state_groundtruth_estimate0"
    state.mkdir()
    (state / "data.csv").write_text("#timestamp, p_RS_R_x [m], ...\n" + "\n".join(rows) + "\n")
    return folder


def write_kitti_sequence(folder, count=FRAMES):
    truth = path(count)
    _pictures(folder / "image_0", [f"{number:06d}.png" for number in range(count)])
    (folder / "times.txt").write_text("\n".join(f"{time_s:e}" for time_s in truth.times_s) + "\n")
    projection = "8.0e+01 0 4.7e+01 0 0 8.1e+01 3.6e+01 0 0 0 1 0"
    (folder / "calib.txt").write_text(f"P0: {projection}\nP1: {projection}\nTr: 1 0 0 0\n")
    poses = folder.parents[1] / "poses"
    poses.mkdir(exist_ok=True)
    rows = [" ".join(f"{value:.9e}" for value in pose[:3].ravel()) for pose in truth.world_from_cam]
    (poses / f"{folder.name}.txt").write_text("\n".join(rows) + "\n")
    return folder


class ConstantMotion:
    """Tells the true path in a world of its own, from the fourth picture on; LOST for pictures of another size."""

    world_from_truth = exp(np.array([0.3, -0.5, 0.2, 1.0, 2.0, 3.0, np.log(0.4)]))
    takes_s = 0.0

    def __init__(self, camera, *, single_process=False, seed=0):
        self.camera, self.seen, self.poses, self.is_closed = camera, 0, [], False

    def track(self, image, time_s):
        self.seen += 1
        time.sleep(self.takes_s)
        self.first_s = time_s if self.seen == 1 else self.first_s
        if image.shape != (self.camera.height_px, self.camera.width_px):
            return SlamFrame(STATES.LOST, reason="a picture of another size")
        if self.seen <= 3:
            return SlamFrame(STATES.INITIALIZING, reason="too little motion")
        pose = self.world_from_truth @ pose_at(time_s - self.first_s)
        pose[:3, :3] /= 0.4
        self.poses.append((time_s, pose))
        return SlamFrame(STATES.TRACKING, inverse(pose), keyframe=self.seen % 5 == 0, matches=50)

    def finish(self):
        assert not self.is_closed

    def trajectory(self):
        return list(self.poses)

    def keyframes(self):
        return self.poses[::5]

    def points(self):
        return np.random.default_rng(0).normal(0, 1, (40, 3))

    def statistics(self):
        return SlamStatistics(
            frames=self.seen, tracked=len(self.poses), keyframes=len(self.keyframes()), points=40, maps=1, loops=2,
            timings_ms={"tracking": [1.0, 2.0, 3.0]},
        )  # fmt: skip

    def close(self):
        self.is_closed = True
