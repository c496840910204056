"""The thesis's program on the robot (listing A.1), as far as its wire and its wheels go; run by tests as a program.

Waits for a station on both ports, then again and again: a picture out, a question for the proximity sensors under way,
two bytes awaited for as long as it takes and read *unsigned*, both motor targets written, and stopped by its obstacle
rule. The sensors' answer is handled between two turns of its main loop, so the rule goes by the reading before.

    thesis_agent.py PORT WIDTH HEIGHT FRAMES PERIOD_S [PROXIMITY]

FRAMES: a file of width * height bytes a picture, shown over and over, one per PERIOD_S at the fastest. PROXIMITY: JSON,
a list of the five front readings per exchange; the last one stays. Prints a JSON line per exchange: the two bytes, and
the motor targets in the order they were written. Ends with its station.
"""

import contextlib
import json
import socket
import sys
import time
from pathlib import Path


def main() -> None:
    port, width, height = (int(word) for word in sys.argv[1:4])
    pictures = Path(sys.argv[4]).read_bytes()
    period_s = float(sys.argv[5])
    readings = json.loads(sys.argv[6]) if len(sys.argv) > 6 else [[0] * 5]
    size = width * height

    with socket.create_server(("127.0.0.1", port)) as images, socket.create_server(("127.0.0.1", port + 1)) as orders:
        print("waiting for a station", file=sys.stderr, flush=True)
        image, _ = images.accept()
        order, _ = orders.accept()
    proximity = [0] * 5
    exchange = 0
    while True:
        start = exchange * size % len(pictures)
        due_s = time.monotonic() + period_s
        with contextlib.suppress(OSError):  # a station that has left may have left a command
            image.sendall(pictures[start : start + size])
        order_bytes = order.recv(2, socket.MSG_WAITALL)
        if len(order_bytes) < 2:
            return
        left, right = order_bytes[0], order_bytes[1]
        targets = [[left, right]]
        if proximity[2] > 1000 or proximity[4] > 1000 or proximity[3] > 2000:
            targets.append([0, 0])
        print(json.dumps({"bytes": [left, right], "targets": targets}), flush=True)
        proximity = readings[min(exchange, len(readings) - 1)]
        exchange += 1
        time.sleep(max(0.0, due_s - time.monotonic()))


main()
