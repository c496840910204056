"""A recording gives back what was recorded, bit for bit, and a damaged one what is left of it."""

from __future__ import annotations

import errno
import io
import logging
import random
import struct
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

from base_station.errors import StationError
from base_station.geometry import FlatPose, PinholeCamera
from base_station.orders import Order
from base_station.recording import jpeg, protobuf, recorder, topics
from base_station.recording.jpeg import JpegEncoder
from base_station.recording.mcap_file import Message, Metadata
from base_station.recording.reader import Recording
from base_station.recording.recorder import Recorder
from base_station.station import Step
from base_station.types import Box, Frame, TrackerResult, TrackingState
from protocol import Command, FrameStamp, Telemetry, Truth
from tests.helpers import numbered_picture

CAMERA = PinholeCamera(
    width=160, height=120, fx=130.1, fy=131.7, cx=79.3, cy=60.9, distortion=(-0.28, 0.09, 0.001, -1e-05)
)
TRACKED = TrackerResult(
    state=TrackingState.TRACKING, shift_px=1 / 3, bearing_rad=-0.1, zoom=1.0000000000000002, confidence=0.7,
    box=Box(10.25, 20, 30.5, 40), cam_from_world=np.arange(16.0).reshape(4, 4) / 7,
)  # fmt: skip
LOST = TrackerResult(state=TrackingState.LOST, reason="nothing like it", confidence=0.1, compass_rad=0.2)


def a_step(number: int, *, image: np.ndarray | None = None, **changed: object) -> Step:
    picture = numbered_picture(number) if image is None else image
    frame = Frame(image=picture, number=number, time_s=100 + number / 30, camera=CAMERA, connection="here:1")
    step = Step(
        frame=frame, result=TRACKED, shadow=None, command=Command(-3, 100), learned=number == 1, tracker_s=0.001,
        frame_to_command_s=0.002, tracker="ztransform", shadow_tracker=None, behaviour="follow", orders=(), notices=(),
    )  # fmt: skip
    return replace(step, **changed)  # type: ignore[arg-type]


def record(path: Path, steps: list[Step], *, raw: bool = True, **options: object) -> Path:
    made = Recorder(path, raw=raw, run={"options": {"tracker": "ztransform"}}, **options)  # type: ignore[arg-type]
    for step in steps:
        made.note_step(step)
    made.close()
    assert not made.failure
    return path


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    return record(tmp_path / "run.mcap", [a_step(number) for number in range(1, 61)])


def test_every_bit_comes_back(tmp_path: Path):
    orders = (Order.learn(Box(1, 2.5, 30, 40)), Order(kind="tracker", name="phase"), Order(kind="shadow"))
    steps = [
        a_step(1, orders=orders, notices=("oh",)),
        a_step(2, result=LOST, shadow=TRACKED, shadow_tracker="phase", pan_rad=0.25),
        a_step(3, result=TrackerResult(state=TrackingState.INITIALIZING, reason="dark", confidence=float("nan"))),
    ]
    recording = Recording(
        record(tmp_path / "run.mcap", steps, driven=lambda frame: FlatPose(x_m=1, y_m=2, heading_rad=3))
    )
    back = list(recording)
    assert recording.raw
    assert recording.option("tracker") == "ztransform"
    assert recording.notes == []
    for step, found in zip(steps, back, strict=True):
        assert found.frame is not None
        assert np.array_equal(found.frame.image, step.frame.image)
        assert replace(found.frame, image=step.frame.image) == step.frame
        assert found.command == step.command
        assert found.orders == step.orders
        assert (found.learned, found.pan_rad, found.tracker) == (step.learned, step.pan_rad, step.tracker)
        for name in topics.MEASURES[:-2]:
            assert getattr(found.result, name) == getattr(step.result, name)
        assert (found.result.state, found.result.reason, found.result.box) == (
            step.result.state, step.result.reason, step.result.box,
        )  # fmt: skip
    assert np.array_equal(back[0].result.cam_from_world, TRACKED.cam_from_world)
    assert back[1].result.compass_rad == 0.2
    assert back[1].shadow is not None and back[1].shadow.zoom == TRACKED.zoom
    assert back[2].result.confidence == 0.0  # JSON knows no NaN
    assert recording.odometry[0][1][:2, 3].tolist() == [1, 2]


def test_pictures_without_raw_are_jpegs_that_look_the_same(tmp_path: Path):
    step = a_step(5)
    (found,) = Recording(record(tmp_path / "run.mcap", [step], raw=False))
    assert found.frame is not None
    differ = np.abs(found.frame.image[:, 2:].astype(int) - step.frame.image[:, 2:])
    assert 0 < differ.max() < 40
    assert differ.mean() < 3


def test_noisy_pictures_keep_to_the_budget_and_quiet_ones_are_good():
    encoder, chance = JpegEncoder(), np.random.default_rng(1)
    noisy = [chance.integers(60, 200, (120, 160), np.uint8) for _ in range(80)]
    sizes = [len(encoder.encode(picture)) for picture in noisy]
    assert sizes[-1] < 0.5 * sizes[0]
    quiet = cv2.GaussianBlur(numbered_picture(1), (0, 0), 3)
    for _ in range(60):
        data = encoder.encode(quiet)
    assert encoder.quality == jpeg.BEST
    assert len(data) < jpeg.BYTES_PER_PX * quiet.size
    milder = [np.clip(quiet + chance.normal(0, 6, quiet.shape), 0, 255).astype(np.uint8) for _ in range(120)]
    assert np.mean([len(encoder.encode(picture)) for picture in milder][-60:]) < 1.02 * jpeg.BYTES_PER_PX * quiet.size


def test_a_band_of_rows_keeps_its_place(tmp_path: Path):
    whole = numbered_picture(7)
    band = a_step(7)
    band = replace(band, frame=replace(band.frame, image=whole[30:70], first_row=30, full_height=120))
    (found,) = Recording(record(tmp_path / "run.mcap", [band]))
    assert found.frame is not None
    assert (found.frame.first_row, found.frame.shape, found.frame.is_whole) == (30, (120, 160), False)
    assert np.array_equal(found.frame.image, whole[30:70])


def test_the_truth_is_found_whether_it_comes_before_its_frame_or_after(tmp_path: Path):
    made = Recorder(tmp_path / "run.mcap", raw=True)

    def stamp_of(number: int) -> FrameStamp:
        return FrameStamp(connection=1, number=number, capture_s=1.0, dropped=0, rows=(3, 9))

    def tell(number: int) -> None:
        truth = Truth(robot=(number, 2.0, 0.5), bearing_rad=0.1, range_m=0.4, in_view=True)
        told = Telemetry(sequence=1, monotonic_s=1, wall_s=2, frame=stamp_of(number), station="here:1", truth=truth)
        made.note_telemetry(told)

    tell(1)
    made.note_step(a_step(1))
    made.note_step(a_step(2))
    tell(2)
    made.close()
    recording = Recording(made.path)
    assert len(list(recording)) == 2
    assert recording.telemetry is not None and recording.telemetry.frame == stamp_of(2)
    assert {key: truth.robot[0] for key, truth in recording.truths.items()} == {("here:1", 1): 1, ("here:1", 2): 2}


def test_the_fields_own_reader_finds_the_fields_own_schemas(recorded: Path):
    with recorded.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    names = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    assert names[topics.CAMERA] == "foxglove.RawImage"
    assert names[topics.CALIBRATION] == "foxglove.CameraCalibration"
    assert names[topics.SLAM_POSE] == "foxglove.PoseInFrame"
    assert names[topics.ANNOTATIONS] == "foxglove.ImageAnnotations"
    assert names[topics.TRACKER] == "zservo.TrackerResult"
    counts = {
        names[summary.channels[number].topic]: count
        for number, count in summary.statistics.channel_message_counts.items()
    }
    assert counts["foxglove.RawImage"] == 60


def test_each_picture_has_its_box_over_it_at_its_own_time(tmp_path: Path):
    """As a viewer puts them together: equal times, pixels of the recorded picture, also where that is a band."""
    band = a_step(2)
    image = band.frame.image[20:90]
    band = replace(band, frame=replace(band.frame, image=image, first_row=20, full_height=120), shadow=TRACKED)
    lost = a_step(3, result=TrackerResult(state=TrackingState.LOST, reason="gone"))
    path = record(tmp_path / "run.mcap", [a_step(1), band, lost])
    found: dict[str, list[tuple[int, protobuf.Fields]]] = {topics.CAMERA: [], topics.ANNOTATIONS: []}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(topics=list(found)):
            found[channel.topic].append((message.log_time, protobuf.fields_of(message.data)))
    pictures, annotations = found.values()
    assert [when for when, _ in pictures] == [when for when, _ in annotations]
    # by the schema: picture's timestamp 1; annotations' points 2, texts 3, timestamp 5; points' own 3; x 1 and y 2
    assert [fields[1] for _, fields in pictures] == [fields[5] for _, fields in annotations]

    def corners(fields: protobuf.Fields) -> list[list[tuple[float, float]]]:
        boxes = [protobuf.fields_of(box)[3] for box in fields.get(2, ())]
        return [[(at[1], at[2]) for at in map(doubles, points)] for points in boxes]

    def doubles(data: bytes) -> dict[int, float]:
        named = protobuf.fields_of(data)
        return {number: struct.unpack("<d", named[number][0])[0] if number in named else 0.0 for number in (1, 2)}

    box = TRACKED.box
    assert box is not None
    right, low = box.x + box.width, box.y + box.height
    drawn = [(box.x, box.y), (right, box.y), (right, low), (box.x, low)]
    assert corners(annotations[0][1]) == [drawn]
    assert corners(annotations[1][1]) == [[(x, y - 20) for x, y in drawn]] * 2
    assert corners(annotations[2][1]) == [] and len(annotations[2][1][3]) == 1


@pytest.mark.parametrize("simulated", [False, True])
def test_a_real_robots_camera_stands_where_its_wheels_took_it(tmp_path: Path, simulated: bool):
    """In 3-D a viewer finds the picture's frame, `camera`: in `odometry`, unless a simulation tells of a `world`."""
    made = Recorder(tmp_path / "run.mcap", driven=lambda frame: FlatPose(x_m=1.0, y_m=2.0, heading_rad=0.0))
    truth = Truth(robot=(0, 0, 0), bearing_rad=0.1, range_m=0.4, in_view=True) if simulated else None
    stamp = FrameStamp(connection=1, number=9, capture_s=1.0, dropped=0)
    made.note_telemetry(Telemetry(sequence=1, monotonic_s=1, wall_s=2, frame=stamp, station="here:1", truth=truth))
    made.note_step(a_step(1))
    made.close()
    path = made.path
    with path.open("rb") as file:
        told = [protobuf.fields_of(message.data) for *_, message in make_reader(file).iter_messages(["/tf"])]
    if simulated:
        assert told == []
        return
    (fields,) = told
    assert (fields[2], fields[3]) == ([b"odometry"], [b"camera"])
    moved = protobuf.fields_of(fields[4][0])  # type: ignore[arg-type]
    assert [struct.unpack("<d", moved[number][0])[0] for number in (1, 2)] == [1.0, 2.0]  # type: ignore[arg-type]


def test_of_a_file_that_is_cut_short_the_front_is_read(recorded: Path, tmp_path: Path):
    data = recorded.read_bytes()
    cut = tmp_path / "cut.mcap"
    most = 0
    for size in range(len(data) // 20, len(data), len(data) // 20):
        cut.write_bytes(data[:size])
        frames, said = read(cut)
        assert frames >= most, "more of the file, fewer frames"
        most = frames
        assert "cut short" in said or "damaged" in said or "holds no frames" in said or frames == 60
    assert most >= 30


def test_garbage_is_no_traceback(recorded: Path, tmp_path: Path):
    data, bad, chance = recorded.read_bytes(), tmp_path / "bad.mcap", random.Random(3)
    for _ in range(60):
        spoilt = bytearray(data)
        for _ in range(chance.choice((1, 3, 50))):
            spoilt[chance.randrange(8, len(spoilt))] = chance.randrange(256)
        bad.write_bytes(spoilt)
        frames, _ = read(bad)
        assert 0 <= frames <= 60


class Entries:
    """A file's entries in memory."""

    damage = ""

    def __init__(self, entries: list[Message | Metadata]) -> None:
        self._entries = entries

    def __iter__(self) -> Iterator[Message | Metadata]:
        return iter(self._entries)


def test_messages_that_make_no_sense_are_no_traceback(recorded: Path):
    """Behind the file's check sums, as another program might have written them."""
    chance, recording = random.Random(4), Recording(recorded)
    entries = list(recording._file)[:40]
    odd = [b"null", b"-1", b"1e999", b"9" * 400, b'"x"', b"[]", b"{}", b"[" * 3000, b"NaN", b"\xff", b"2", b"true"]
    refused = 0
    for _ in range(400):
        spoilt = list(entries)
        place = chance.choice([at for at, entry in enumerate(spoilt) if isinstance(entry, Message)])
        message = spoilt[place]
        assert isinstance(message, Message)
        data = bytearray(message.data)
        at = chance.randrange(len(data))
        if data[:1] == b"{" and chance.random() < 0.7:
            begin = data.find(b":", at) + 1 or 1
            end = min((cut for cut in (data.find(b",", begin), data.find(b"}", begin)) if cut > 0), default=len(data))
            data[begin:end] = chance.choice(odd)
        elif chance.random() < 0.3:
            del data[at:]
        else:
            data[at] = chance.randrange(256)
        spoilt[place] = replace(message, data=bytes(data))
        recording._file = Entries(spoilt)  # type: ignore[assignment]
        try:
            assert len(list(recording)) <= 60
        except StationError as error:
            refused += 1
            assert "frames" in str(error)
    assert 80 < refused < 400


def read(path: Path) -> tuple[int, str]:
    """Frames that could be read, and what was said of the rest."""
    frames = 0
    try:
        recording = Recording(path)
        for _ in recording:
            frames += 1
    except StationError as error:
        return frames, str(error)
    return frames, " ".join(recording.notes)


@pytest.mark.parametrize("data", [b"", b"no recording", b"\x89MCAP0\r\n"])
def test_another_file_is_said_to_be_none(tmp_path: Path, data: bytes):
    path = tmp_path / "other.mcap"
    path.write_bytes(data)
    with pytest.raises(StationError, match="is no") as caught:
        Recording(path)
    assert caught.value.usage


def test_a_recording_is_never_written_over(recorded: Path):
    with pytest.raises(StationError, match="there already") as caught:
        Recorder(recorded)
    assert caught.value.usage
    assert len(list(Recording(recorded))) == 60


def test_a_path_that_cannot_be_written_is_a_mistake_of_usage(tmp_path: Path):
    with pytest.raises(StationError, match="cannot be written") as caught:
        Recorder(tmp_path / "nowhere" / "run.mcap")
    assert caught.value.usage


def test_a_slow_disk_costs_pictures_and_is_said_and_orders_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    may_write = threading.Event()
    truly_write = io.FileIO.write
    monkeypatch.setattr(recorder, "MOST_QUEUED_BYTES", 5 * 160 * 120)
    made = Recorder(tmp_path / "run.mcap", raw=True)

    class Slow(io.FileIO):
        def write(self, data: object) -> int:
            may_write.wait()
            return truly_write(self, data)  # type: ignore[arg-type]

    slow = Slow(made.path, "r+b")
    slow.seek(0, io.SEEK_END)
    made._file._sink._file = slow
    with caplog.at_level(logging.WARNING):
        for number in range(1, 31):
            made.note_step(a_step(number, orders=(Order.learn(None),) if number == 25 else ()))
    assert [record.message for record in caplog.records] == [
        "The recording cannot keep up (a slow disk or processor): pictures are left out of it."
    ]
    may_write.set()
    made.close()
    steps = list(Recording(made.path))
    without = sum(step.frame is None for step in steps)
    assert 20 <= without == made.frames_without_picture < 30
    assert [step.key[1] for step in steps] == list(range(1, 31))
    assert [step.key[1] for step in steps if step.orders] == [25]
    assert f"{without} of them without their picture" in made.described()


@pytest.mark.parametrize(("patient", "who"), [(False, "robot"), (True, "replay")])
def test_a_full_disk_is_said_with_who_goes_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, patient: bool, who: str
):
    made = Recorder(tmp_path / "run.mcap", raw=True, patient=patient)

    class Full(io.FileIO):
        def write(self, data: object) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    made._file._sink._file = Full(made.path, "r+b")
    for number in range(1, 9):
        made.note_step(a_step(number))
    made.close()
    assert f"No space left on device). The {who} goes on" in caplog.text


@pytest.mark.parametrize("data", [b"\x08", b"\x0a\x05ab", b"\x0b", b"\x09\x01", b"\x08" + b"\xff" * 11])
def test_a_protobuf_message_that_is_none_is_refused(data: bytes):
    with pytest.raises(StationError, match="protobuf"):
        protobuf.fields_of(data)


def test_protobuf_numbers_packed_or_not():
    one = b"\x31" + np.float64(1.5).tobytes()
    packed = b"\x32\x10" + np.array([1.5, -2.0]).tobytes()
    assert protobuf.doubles(protobuf.fields_of(one), 6) == (1.5,)
    assert protobuf.doubles(protobuf.fields_of(packed), 6) == (1.5, -2.0)
    assert protobuf.whole(protobuf.fields_of(b"\x10\xac\x02"), 2) == 300


@pytest.mark.parametrize(
    "spoilt",
    [
        {"state": "HAPPY"}, {"zoom": "1"}, {"zoom": True}, {"zoom": -1.0}, {"box": [1, 2, 3, 4]},
        {"box": {"x": 1, "y": 2, "width": 0, "height": 4}}, {"cam_from_world": [1.0]}, {"reason": 3},
    ],
)  # fmt: skip
def test_a_result_that_is_none_is_refused(spoilt: dict[str, object]):
    fields = topics.loads(topics.TRACKER, topics.dumps(topics.result_fields(TRACKED, "phase")))
    assert topics.result_of(fields).zoom == TRACKED.zoom
    with pytest.raises(StationError):
        topics.result_of(fields | spoilt)


@pytest.mark.parametrize(("module", "make"), [("foxglove", Recorder), ("mcap", Recording)])
def test_a_missing_library_is_one_sentence_that_names_the_extra(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, make: type
):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(StationError, match=r"pip install 'zservo\[record\]'") as caught:
        make(tmp_path / "new.mcap" if make is Recorder else recorded)
    assert caught.value.usage
    assert not (tmp_path / "new.mcap").exists()
