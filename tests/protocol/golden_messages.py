"""One example of everything that crosses the wire, and the files in golden/ that hold its bytes.

The files are the contract with programs already out there: a change of the code that changes them breaks those
programs. Tests only read them. When a change is meant, write them anew, with the hexdumps in protocol/README.md, and
look at the difference before committing it:

    python tests/protocol/golden_messages.py --write
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from protocol import (
    STOP,
    Command,
    FrameStamp,
    Hello,
    Intrinsics,
    PanTiltLimits,
    Reply,
    Request,
    RobotLimits,
    Scenario,
    ScenarioEvent,
    Telemetry,
    Truth,
    encode,
)

FOLDER = Path(__file__).parent / "golden"
README = Path(__file__).parents[2] / "protocol" / "README.md"

FRAME_WIDTH, FRAME_HEIGHT = 6, 4

REQUEST = Request(action="stop", text="by the operator")

LOOK = Request(action="look", pan_rad=0.5, tilt_rad=-0.25)

ROWS = Request(action="rows", rows=(208, 272), station="192.168.0.20:51000")

ROWS_REPLY = Reply(ok=True, frame=10)

HELLO_REPLY = Reply(
    ok=True,
    hello=Hello(
        protocol=1,
        agent="zservo robot-agent 0.1.0",
        width=640,
        height=64,
        first_row=208,
        full_height=480,
        fps=30.0,
        rhythm="free",
        robot="sim",
        camera="SimCamera",
        intrinsics=Intrinsics(fx=530.5, fy=530.5, cx=319.5, cy=31.5),
        limits=RobotLimits(max_units=500, speed_scale=4.0, metres_per_unit_s=0.000325, wheel_base_m=0.094),
        capabilities=("stop", "pan-tilt", "show"),
        busy_with="192.168.0.20:51000",
        monotonic_s=12.5,
        scenario=Scenario(
            name="leader", seed=3, events=(ScenarioEvent(kind="learn", frame=1, box=(250.0, -10.0, 140.0, 140.0)),)
        ),
        pan_tilt=PanTiltLimits(pan_rad=(-1.5, 1.5), tilt_rad=(-1.0, 1.0), slew_rad_s=3.0),
    ),
)

REFUSAL = Reply(ok=False, error="this camera's exposure cannot be set")

TELEMETRY = Telemetry(
    sequence=17,
    monotonic_s=12.5,
    wall_s=1625000000.25,
    frame=FrameStamp(connection=1, number=9, capture_s=12.25, dropped=2, pan_rad=0.5, tilt_rad=-0.25, rows=(208, 272)),
    proximity=(0, 0, 2411, 0, 0, 0, 0),
    wheels_asked=(-40, 40),
    wheels_measured=(-38, 41),
    battery_v=3.75,
    safety="limited",
    reason="obstacle in front",
    station="192.168.0.20:51000",
    ended=False,
    cpu_s=1.5,
    truth=Truth(
        robot=(0.25, -0.5, 1.5), target=(0.75, -0.5, 1.5), bearing_rad=0.125, range_m=0.5, in_view=True, collisions=0
    ),
)


def frame_bytes() -> bytes:
    """A picture of 6 x 4 px whose gray level is 16 times the row plus the column."""
    return bytes(16 * row + column for row in range(FRAME_HEIGHT) for column in range(FRAME_WIDTH))


def command_bytes() -> bytes:
    """Both ends of the range, stop, and listing A.2's opposite wheels."""
    return b"".join(bytes(command) for command in (Command(127, -128), STOP, Command(-68, 100), Command(-1, 1)))


def pattern_bytes() -> bytes:
    """Listing A.2, typed off the thesis: 15 forward, 5 left wheel back, 5 right wheel back, 15 backward."""
    cycle = 15 * [(100, 100)] + 5 * [(2 * 16 - 100, 100)] + 5 * [(100, 2 * 16 - 100)] + 15 * [(-100, -100)]
    return bytes(wheel % 256 for pair in cycle for wheel in pair)


def golden_files() -> dict[str, bytes]:
    """What the files must hold, by name."""
    return {
        "frame_6x4.bin": frame_bytes(),
        "commands.bin": command_bytes(),
        "commands_listing_a2.bin": pattern_bytes(),
        "request.bin": encode(REQUEST),
        "request_look.bin": encode(LOOK),
        "request_rows.bin": encode(ROWS),
        "reply_rows.bin": encode(ROWS_REPLY),
        "reply_hello.bin": encode(HELLO_REPLY),
        "reply_refused.bin": encode(REFUSAL),
        "telemetry.bin": encode(TELEMETRY),
    }


def hexdump(data: bytes) -> str:
    """As `hexdump -C` prints it: offset, sixteen bytes, and the same as text."""
    lines = []
    for start in range(0, len(data), 16):
        part = data[start : start + 16]
        pairs = " ".join(f"{byte:02x}" for byte in part[:8]) + "  " + " ".join(f"{byte:02x}" for byte in part[8:])
        text = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in part)
        lines.append(f"{start:08x}  {pairs:<48}  |{text}|")
    return "\n".join([*lines, f"{len(data):08x}"])


def dumps_in(text: str) -> dict[str, str]:
    """The hexdumps of a document, by the file's name: blocks fenced with ```hexdump NAME."""
    return {name: body.rstrip("\n") for name, body in re.findall(r"```hexdump (\S+)\n(.*?)```", text, re.DOTALL)}


def with_dumps(text: str) -> str:
    """The document with every hexdump made anew from the golden bytes."""
    files = golden_files()
    return re.sub(
        r"```hexdump (\S+)\n.*?```",
        lambda match: f"```hexdump {match[1]}\n{hexdump(files[match[1]])}\n```",
        text,
        flags=re.DOTALL,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Write the golden files and the README's hexdumps anew.")
    parser.add_argument("--write", action="store_true", required=True, help="yes, overwrite them")
    parser.parse_args()
    FOLDER.mkdir(exist_ok=True)
    for name, data in golden_files().items():
        (FOLDER / name).write_bytes(data)
        print(f"{name}: {len(data)} bytes")
    README.write_text(with_dumps(README.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
