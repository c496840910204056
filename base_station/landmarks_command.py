"""base-station landmarks: learn, list, forget and find landmarks, in pictures or in what a robot sees now."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import tyro
from threadpoolctl import threadpool_limits
from tyro.conf import arg

from base_station.errors import StationError, counted
from base_station.geometry import DEFAULT_FOV_RAD, PinholeCamera
from base_station.link import Link
from base_station.output_files import check_output
from base_station.scale import Scale, scale_from_distance, scale_from_width
from base_station.session import LinkSettings
from base_station.types import Box, Frame, TrackerResult, TrackingState
from protocol import FRAME_PORT

DEFAULT_MEMORY = Path("landmarks.npz")
PATIENCE_S = 10.0
MOST_PIXELS = 8192


@dataclass(frozen=True, kw_only=True)
class Source:
    """Where the picture comes from."""

    image: Path | None = None
    """A picture, a video, or a folder of pictures. Default: what the robot sees now."""
    frame: int = 1
    """Which picture of a video or folder, from 1."""
    fov_deg: float = math.degrees(DEFAULT_FOV_RAD)
    """Horizontal field of view of the camera that took the picture."""
    host: str = "127.0.0.1"
    """The robot's name or address."""
    port: int = FRAME_PORT
    """The first of the robot's four ports."""


@dataclass(frozen=True, kw_only=True)
class List:
    """List the landmarks."""

    memory: Path = DEFAULT_MEMORY
    """The file of landmarks."""
    json: bool = False
    """As JSON."""


@dataclass(frozen=True, kw_only=True)
class Learn:
    """Learn a landmark and keep it in the memory's file."""

    name: tyro.conf.Positional[str]
    """What to call it. One of this name is replaced."""
    memory: Path = DEFAULT_MEMORY
    """The file of landmarks; made when there is none."""
    target: str | None = None
    """Box x,y,width,height in px. Default: what the simulation says, else the whole view (a place)."""
    place: bool = False
    """The whole view, whatever the simulation says."""
    target_width_m: float | None = None
    """How wide the target is; then its distance is known later."""
    learned_distance_m: float | None = None
    """How far away it is now; the same."""
    source: Source = dataclasses.field(default_factory=Source)


@dataclass(frozen=True, kw_only=True)
class Forget:
    """Forget a landmark."""

    name: tyro.conf.Positional[str]
    memory: Path = DEFAULT_MEMORY
    """The file of landmarks."""


@dataclass(frozen=True, kw_only=True)
class Find:
    """Which landmarks are in view, where, and how large."""

    memory: Path = DEFAULT_MEMORY
    """The file of landmarks."""
    json: bool = False
    """As JSON, with the time that the look-up took."""
    source: Source = dataclasses.field(default_factory=Source)


@dataclass(frozen=True, kw_only=True)
class Landmarks:
    """The memory of landmarks: learn, list, forget, find."""

    action: Annotated[List | Learn | Forget | Find, arg(name="")]


def landmarks(command: Landmarks) -> None:
    """Do it. Raises StationError."""
    with threadpool_limits(1):
        action = command.action
        if isinstance(action, Learn):
            _learn(action)
        elif isinstance(action, Forget):
            _forget(action)
        elif isinstance(action, Find):
            _find(action)
        else:
            _list(action)


def parse_box(text: str) -> Box:
    """x,y,width,height in px. Raises StationError."""
    try:
        x, y, width, height = (float(part) for part in text.split(","))
        return Box(x, y, width, height)
    except ValueError:
        raise StationError(
            f"--target {text}: write x,y,width,height in px, such as 250,150,140,140.", usage=True
        ) from None


def scale_of(
    box: Box | None, camera: PinholeCamera, *, width_m: float | None, distance_m: float | None
) -> Scale | None:
    """What --target-width-m or --learned-distance-m tell of what is learned. Raises StationError."""
    for name, value in (("--target-width-m", width_m), ("--learned-distance-m", distance_m)):
        if value is not None and not 0 < value < math.inf:
            raise StationError(f"{name} must be positive, not {value}.", usage=True)
    if width_m is not None and distance_m is not None:
        raise StationError("Give --target-width-m or --learned-distance-m: one tells the other.", usage=True)
    if distance_m is not None:
        return scale_from_distance(distance_m, box, camera)
    if width_m is not None and box is None:
        raise StationError("--target-width-m needs a target: the whole view has no width in metres.", usage=True)
    return scale_from_width(width_m, box, camera) if width_m is not None and box is not None else None


def _learn(action: Learn) -> None:
    from base_station.trackers.ztransform.landmark_file import read_landmarks, write_landmarks
    from base_station.trackers.ztransform.lookup import LandmarkMemory

    if action.target is not None and action.place:
        raise StationError("--place is the whole view: leave out --target.", usage=True)
    _check_name(action.name)
    check_output("--memory", action.memory)
    asked = parse_box(action.target) if action.target is not None else None
    scale_of(Box(0, 0, 1, 1), _camera(1, 1, 60), width_m=action.target_width_m, distance_m=action.learned_distance_m)
    kept = read_landmarks(action.memory) if action.memory.exists() else []
    frame, operators = _picture(action.source)
    if asked is not None and asked.clipped(frame.camera.width, frame.camera.height) is None:
        size = f"{frame.camera.width}x{frame.camera.height}"
        raise StationError(f"--target {action.target} lies outside of the picture, which has {size} px.", usage=True)
    box = asked if asked is not None or action.place else operators
    scale = scale_of(box, frame.camera, width_m=action.target_width_m, distance_m=action.learned_distance_m)
    memory = LandmarkMemory()
    for landmark in kept:
        memory.add(landmark)
    try:
        memory.learn(action.name, frame, box, learned_depth_m=scale.learned_depth_m if scale is not None else None)
    except ValueError as error:
        raise StationError(f"Cannot learn {action.name!r}: {error}.") from error
    write_landmarks(action.memory, memory.landmarks)
    how = "learned anew, and replaced," if action.name in {landmark.name for landmark in kept} else "learned"
    print(f"{how} {action.name!r} ({_what(box)}); {action.memory} holds {counted(len(memory), 'landmark')}")


def _check_name(name: str) -> None:
    from base_station.trackers.ztransform.landmark import check_name

    try:
        check_name(name)
    except ValueError as error:
        raise StationError(f"{error}.", usage=True) from error


def _forget(action: Forget) -> None:
    from base_station.trackers.ztransform.landmark_file import read_landmarks, write_landmarks

    kept = read_landmarks(action.memory)
    if action.name not in {landmark.name for landmark in kept}:
        raise StationError(unknown_text(action.name, action.memory, [landmark.name for landmark in kept]), usage=True)
    write_landmarks(action.memory, [landmark for landmark in kept if landmark.name != action.name])
    print(f"forgot {action.name!r}; {action.memory} holds {counted(len(kept) - 1, 'landmark')}")


def _list(action: List) -> None:
    from base_station.trackers.ztransform.landmark_file import LANDMARK_BYTES, read_landmarks

    kept = read_landmarks(action.memory)
    if action.json:
        rows = [
            {
                "name": landmark.name,
                "box": _box_numbers(landmark.box),
                "frame": [landmark.camera.width, landmark.camera.height],
                "learned_depth_m": landmark.learned_depth_m,
                "bytes": LANDMARK_BYTES,
            }
            for landmark in kept
        ]
        print(json.dumps(rows, indent=2))
        return
    for landmark in kept:
        depth = f", {landmark.learned_depth_m:.2f} m away" if landmark.learned_depth_m is not None else ""
        print(f"{landmark.name}  ({_what(landmark.box)} of {landmark.camera.width}x{landmark.camera.height}{depth})")
    if not kept:
        print(f"{action.memory} holds no landmarks")


def _find(action: Find) -> None:
    from base_station.trackers.ztransform.landmark_file import read_landmarks
    from base_station.trackers.ztransform.lookup import LandmarkMemory

    memory = LandmarkMemory()
    for landmark in read_landmarks(action.memory):
        memory.add(landmark)
    frame, _ = _picture(action.source)
    memory.find(frame)  # the first one loads the kernels and groups the landmarks
    begun_s = time.perf_counter()
    seen = memory.find(frame)
    took_ms = (time.perf_counter() - begun_s) * 1e3
    rows = []
    for sighting in seen:
        result = TrackerResult(
            state=TrackingState.TRACKING,
            bearing_rad=sighting.bearing_rad,
            elevation_rad=sighting.elevation_rad,
            zoom=sighting.zoom,
        )
        depth_m = sighting.landmark.learned_depth_m
        range_m = Scale(learned_depth_m=depth_m).measured(result).range_m if depth_m is not None else None
        rows.append(
            {
                "name": sighting.landmark.name,
                "confidence": round(sighting.confidence, 4),
                "bearing_deg": round(math.degrees(sighting.bearing_rad), 3),
                "elevation_deg": round(math.degrees(sighting.elevation_rad), 3),
                "zoom": round(sighting.zoom, 4),
                "range_m": None if range_m is None else round(range_m, 4),
                "box": _box_numbers(sighting.box),
            }
        )
    if action.json:
        print(json.dumps({"landmarks": len(memory), "lookup_ms": round(took_ms, 3), "seen": rows}, indent=2))
        return
    for row in rows:
        away = f"  range {row['range_m']:.3f} m" if row["range_m"] is not None else ""
        print(
            f"{row['name']}  bearing {row['bearing_deg']:+.2f}°  zoom {row['zoom']:.3f}{away}"
            f"  confidence {row['confidence']:.2f}"
        )
    if not rows:
        print(f"none of {counted(len(memory), 'landmark')} is in view")


def unknown_text(name: str, memory: Path, known: list[str]) -> str:
    """For a person who asked for a landmark that there is not."""
    some = ", ".join(known[:12]) + (", …" if len(known) > 12 else "") if known else "no landmarks"
    return f"There is no landmark {name!r} in {memory}; it holds {some}."


def _picture(source: Source) -> tuple[Frame, Box | None]:
    """The picture, and the box of the simulated operator if there is one. Raises StationError."""
    if source.image is None:
        return _live(source)
    if not 10 <= source.fov_deg <= 170:
        raise StationError(f"--fov-deg must be 10..170, not {source.fov_deg:g}.", usage=True)
    if source.frame < 1:
        raise StationError(f"--frame counts from 1, not {source.frame}.", usage=True)
    image = _read(source.image, source.frame)
    rows, columns = image.shape
    if max(rows, columns) > MOST_PIXELS:
        raise StationError(f"{source.image} is {columns}x{rows}: {MOST_PIXELS} px a side are the most.", usage=True)
    return Frame(image=image, number=1, time_s=0.0, camera=_camera(columns, rows, source.fov_deg)), None


def _camera(columns: int, rows: int, fov_deg: float) -> PinholeCamera:
    return PinholeCamera.with_fov(columns, rows, math.radians(fov_deg))


def _read(path: Path, number: int) -> np.ndarray:
    """Gray, uint8 (rows, columns)."""
    if path.is_dir():
        names = sorted(p for p in path.iterdir() if p.suffix.lower() in (".png", ".jpg", ".jpeg", ".pgm", ".bmp"))
        if number > len(names):
            many = counted(len(names), "picture")
            raise StationError(f"{path} holds {many}, there is no number {number}.", usage=True)
        path, number = names[number - 1], 1
    if not path.is_file():
        raise StationError(f"There is no picture {path}.", usage=True)
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.stat().st_size else None
    if image is not None:
        if number > 1:
            raise StationError(f"{path} is a single picture, there is no number {number}.", usage=True)
        return np.asarray(image, np.uint8)
    video = cv2.VideoCapture(str(path))
    try:
        for _ in range(number):
            good, picture = video.read()
            if not good:
                raise StationError(f"{path} is no picture, and no video with a picture {number}.", usage=True)
    finally:
        video.release()
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture, np.uint8)


def _live(source: Source) -> tuple[Frame, Box | None]:
    """One frame of a robot that stands."""
    if not 1 <= source.port <= 65532:
        raise StationError(f"--port must be 1..65532 (four ports in a row), not {source.port}.", usage=True)
    with Link(LinkSettings(host=source.host, port=source.port)) as link:
        received = link.next_frame(PATIENCE_S)
        if received is None:
            raise StationError(
                f"No frame came from {source.host}:{source.port} ({link.state}). Is the agent running there?"
                " For a picture from a file give --image."
            )
        event = next((event for event in link.events if event.kind == "learn" and event.box is not None), None)
        return received[0], Box(*event.box) if event is not None and event.box is not None else None


def _what(box: Box | None) -> str:
    return "a place" if box is None else f"{box.width:.0f}x{box.height:.0f} px"


def _box_numbers(box: Box | None) -> list[float] | None:
    return None if box is None else [round(value, 2) for value in (box.x, box.y, box.width, box.height)]
