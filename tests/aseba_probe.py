"""Looks at the Thymio of a playground from the side, with Debian's python3-dbus; run by tests as a program.

Prints a JSON line per look: the time (monotonic, s), both wheel targets, the proximity readings, the robot's pose (cm,
rad). A line "x y angle" on its standard input puts the robot there.
"""

import json
import select
import sys
import time

import dbus

ASEBA = "ch.epfl.mobots.Aseba"
PLAYGROUND = "ch.epfl.mobots.AsebaPlayground"
THING = "ch.epfl.mobots.EnkiPhysicalObject"


def find_robot(bus: dbus.SessionBus) -> dbus.Interface:
    """The robot's pose in the playground, once that is there."""
    while True:
        try:
            world = dbus.Interface(bus.get_object(PLAYGROUND, "/world"), "ch.epfl.mobots.EnkiWorld")
            path = world.PhysicalObject(world.PhysicalObjectsByType("Thymio2")[0])
            return dbus.Interface(bus.get_object(PLAYGROUND, path), "org.freedesktop.DBus.Properties")
        except dbus.DBusException:
            time.sleep(0.1)


def main() -> None:
    bus = dbus.SessionBus()
    thing = find_robot(bus)
    while True:
        if select.select([sys.stdin], [], [], 0)[0]:
            line = sys.stdin.readline()
            if not line:
                return
            for name, text in zip(("x", "y", "angle"), line.split(), strict=True):
                thing.Set(THING, name, float(text))
        look = {name: float(thing.Get(THING, name)) for name in ("x", "y", "angle")}
        try:
            network = dbus.Interface(bus.get_object(ASEBA, "/"), "ch.epfl.mobots.AsebaNetwork")
            look["left"] = int(network.GetVariable("thymio-II", "motor.left.target")[0])
            look["right"] = int(network.GetVariable("thymio-II", "motor.right.target")[0])
            look["proximity"] = [int(value) for value in network.GetVariable("thymio-II", "prox.horizontal")]
        except dbus.DBusException:
            time.sleep(0.02)  # no asebamedulla just now: the pose is still told
        look["time_s"] = time.monotonic()
        print(json.dumps(look), flush=True)


main()
