"""Bundle adjustment by pycolmap (Ceres): keyframes and points together, so that all observations fit best.

pycolmap measures every residual in pixels of the camera that saw it, and a keypoint found on a coarse pyramid level
is less sure. So a keyframe is given to it as a *rig* of cameras in one place, one for each level, with that level's
pixels: then every residual counts by its own uncertainty.

`BundleAdjuster.solve()` holds the interpreter's lock: this belongs into the mapper's process.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from base_station.trackers.slam import libraries
from base_station.trackers.slam.bundle_problem import BundleProblem
from base_station.trackers.slam.pose_optimization import CHI2_TWO

LONGEST_SOLVE_S = 5.0


def bundle_adjust(
    problem: BundleProblem, intrinsics: np.ndarray, scales: np.ndarray, *, iterations: int = 10, robust: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Better poses (K, 4, 4) and points (P, 3). `scales` (levels,): picture px per px of each level.

    At least two keyframes, or one and a known distance, must be fixed, or the world would float; with none fixed,
    pycolmap fixes the first two. Robust: observations beyond the chi-square bound pull with a bounded force.
    """
    colmap = libraries.pycolmap()
    scene, images = _scene(colmap, problem, intrinsics, scales)
    config = colmap.BundleAdjustmentConfig()
    for image in images:
        config.add_image(image)
    for level in range(len(scales)):
        config.set_constant_cam_intrinsics(level + 1)
        if level:
            config.set_constant_sensor_from_rig_pose(colmap.sensor_t(colmap.SensorType.CAMERA, level + 1))
    used = np.unique(problem.keyframe)
    for row in used[problem.fixed[used]].tolist():
        config.set_constant_rig_from_world_pose(row + 1)
    if not problem.fixed[used].any():
        config.fix_gauge(colmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    colmap.create_default_bundle_adjuster(_options(colmap, iterations, robust), config, scene).solve()
    poses, points = problem.poses.copy(), problem.points.copy()
    for row in used[~problem.fixed[used]].tolist():
        poses[row, :3] = scene.frames[row + 1].rig_from_world.matrix()
    solved = scene.points3D
    for row in np.unique(problem.point).tolist():
        points[row] = solved[row + 1].xyz
    return poses, points


def _options(colmap: Any, iterations: int, robust: bool) -> Any:
    options = colmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_principal_point = options.refine_extra_params = False
    options.refine_sensor_from_rig = options.print_summary = False
    if robust:
        options.ceres.loss_function_type = colmap.LossFunctionType.HUBER
        options.ceres.loss_function_scale = CHI2_TWO**0.5
    solver = options.ceres.solver_options
    solver.max_num_iterations = iterations
    solver.function_tolerance = 1e-4
    solver.max_solver_time_in_seconds = LONGEST_SOLVE_S
    solver.num_threads = 1
    return options


def _scene(colmap: Any, problem: BundleProblem, intrinsics: np.ndarray, scales: np.ndarray) -> tuple[Any, list[int]]:
    """The problem as pycolmap has it, and the numbers of its images. All numbers there begin with 1."""
    scene, rig = colmap.Reconstruction(), colmap.Rig(rig_id=1)
    for level, scale in enumerate(scales):
        fx, fy, cx, cy = intrinsics / scale
        camera = colmap.Camera(
            camera_id=level + 1, model="PINHOLE", width=max(1, int(2 * cx)), height=max(1, int(2 * cy)),
            params=[fx, fy, cx, cy],
        )  # fmt: skip
        scene.add_camera(camera)
        if level == 0:
            rig.add_ref_sensor(camera.sensor_id)
        else:
            rig.add_sensor(camera.sensor_id, colmap.Rigid3d())
    scene.add_rig(rig)
    levels = len(scales)
    image_of = problem.keyframe.astype(np.int64) * levels + problem.octave
    order = np.argsort(image_of, kind="stable")
    images, first = np.unique(image_of[order], return_index=True)
    spans = np.split(order, first[1:])
    index_in_image = np.empty(len(order), np.int64)
    for span in spans:
        index_in_image[span] = np.arange(len(span))
    by_frame: dict[int, list[tuple[int, np.ndarray]]] = {}
    for image, span in zip(images.tolist(), spans, strict=True):
        by_frame.setdefault(image // levels, []).append((image, span))
    uv = problem.uv_px / scales[problem.octave][:, None]
    for row, parts in by_frame.items():
        frame = colmap.Frame(frame_id=row + 1, rig_id=1)
        for image, _ in parts:
            camera_id = image % levels + 1
            frame.add_data_id(colmap.data_t(colmap.sensor_t(colmap.SensorType.CAMERA, camera_id), image + 1))
        frame.rig_from_world = colmap.Rigid3d(problem.poses[row, :3])
        scene.add_frame(frame)
        for image, span in parts:
            picture = colmap.Image(
                name=str(image), keypoints=uv[span], camera_id=image % levels + 1, image_id=image + 1
            )
            picture.frame_id = row + 1
            scene.add_image(picture)
    _add_points(colmap, scene, problem, image_of + 1, index_in_image)
    return scene, [image + 1 for image in images.tolist()]


def _add_points(
    colmap: Any, scene: Any, problem: BundleProblem, image_of: np.ndarray, index_in_image: np.ndarray
) -> None:
    order = np.argsort(problem.point, kind="stable")
    rows, first = np.unique(problem.point[order], return_index=True)
    ends = np.append(first[1:], len(order)).tolist()
    image, index = image_of[order].tolist(), index_in_image[order].tolist()
    make = colmap.TrackElement
    for row, begin, end in zip(rows.tolist(), first.tolist(), ends, strict=True):
        track = colmap.Track([make(image[i], index[i]) for i in range(begin, end)])
        scene.add_point3D_with_id(row + 1, colmap.Point3D(xyz=problem.points[row], track=track))
