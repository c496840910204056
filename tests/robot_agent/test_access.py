"""--allow: who may connect, and that a typing mistake in it is told."""

from __future__ import annotations

import pytest

from robot_agent.access import AllowList
from robot_agent.errors import AgentError


@pytest.mark.parametrize("address", ["127.0.0.1", "8.8.8.8", "::1"])
def test_without_a_list_everybody_may(address):
    assert AllowList().permits(address)


@pytest.mark.parametrize(
    ("networks", "address", "permitted"),
    [
        (("192.168.0.0/24",), "192.168.0.51", True),
        (("192.168.0.0/24",), "192.168.1.51", False),
        (("192.168.0.51/24",), "192.168.0.7", True),
        (("10.0.0.7",), "10.0.0.7", True),
        (("10.0.0.7",), "10.0.0.8", False),
        (("10.0.0.0/8", "192.168.0.0/24"), "192.168.0.1", True),
        (("fe80::/10",), "fe80::1", True),
        (("192.168.0.0/24",), "fe80::1", False),
        (("fe80::/10",), "192.168.0.1", False),
        (("192.168.0.0/24",), "::ffff:192.168.0.9", True),
        (("192.168.0.0/24",), "::ffff:192.168.1.9", False),
    ],
)
def test_a_list_admits_its_networks_and_nobody_else(networks, address, permitted):
    assert AllowList(networks).permits(address) is permitted


@pytest.mark.parametrize("text", ["everybody", "192.168.0.0/33", "300.0.0.1", ""])
def test_what_is_no_network_is_explained(text):
    with pytest.raises(AgentError, match=r"--allow: .*such as 192\.168\.0\.0/24"):
        AllowList(("10.0.0.0/8", text))
