"""An agent's name on the network tells it from others of the same machine's name, without asking them."""

from __future__ import annotations

import re

from robot_agent.announce import MAX_NAME_BYTES, instance_name

PI = 0xB827EB000001


def test_robots_from_one_sd_card_differ_and_keep_their_names() -> None:
    names = {instance_name("raspberrypi", PI + n, port) for n in range(8) for port in (31440, 31450)}
    assert len(names) == 16
    assert all(re.fullmatch(r"raspberrypi-[0-9a-f]{4}", name) for name in names)
    assert instance_name("raspberrypi", PI, 31440) == instance_name("raspberrypi", PI, 31440)


def test_any_host_name_gives_one_label_of_dns() -> None:
    for hostname in ("", ".", "büro.local", "a b_c", "ü" * 100, "x" * 300):
        name = instance_name(hostname, PI, 31440)
        assert "." not in name
        assert len(name.encode()) <= MAX_NAME_BYTES + 5
    assert instance_name("", PI, 31440).startswith("robot-")
    assert instance_name("pi.local", PI, 31440).startswith("pi-")
