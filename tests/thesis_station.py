"""The thesis's program on the PC (listing A.2) without its SLAM; run by tests as a program.

Connects to the pictures, then to the commands, and repeats its cycle of 40: a whole picture in, two `char` out.

    thesis_station.py PORT WIDTH HEIGHT CYCLES FRAMES

Appends the pictures to the file FRAMES as they came, and takes one more at the end, by which its last command has been
obeyed. Prints nothing.
"""

import socket
import struct
import sys
from pathlib import Path

HOST = "127.0.0.1"


def drive(i: int) -> tuple[int, int]:
    """What the listing writes into `chars` for its i-th picture of the cycle."""
    if i < 15:
        return 100, 100
    if i < 20:
        return 2 * 16 - 100, 100
    if i < 25:
        return 100, 2 * 16 - 100
    return -100, -100


def main() -> None:
    port, width, height, cycles = (int(word) for word in sys.argv[1:5])
    with (
        socket.create_connection((HOST, port)) as client_image,
        socket.create_connection((HOST, port + 1)) as client_commands,
        Path(sys.argv[5]).open("wb") as frames,
    ):
        for _ in range(cycles):
            for i in range(40):
                frames.write(receive(client_image, height * width))
                client_commands.sendall(struct.pack("bb", *drive(i)))
        frames.write(receive(client_image, height * width))


def receive(connection: socket.socket, size: int) -> bytes:
    data = connection.recv(size, socket.MSG_WAITALL)
    if len(data) < size:
        sys.exit(f"the robot closed the connection after {len(data)} of {size} bytes")
    return data


main()
