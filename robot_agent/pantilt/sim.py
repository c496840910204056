"""The simulated pan-tilt: joints of the simulated robot, turned by simulated servos."""

from __future__ import annotations

from robot_agent.sim.world import World


class SimPanTilt:
    """Turns the camera of a world's robot. Implements PanTilt; its time is simulated time."""

    def __init__(self, world: World) -> None:
        """The world must have been made with a pan-tilt."""
        if world.pan_tilt is None:
            raise ValueError("this world's camera is fixed")
        self._world = world
        self.limits = world.pan_tilt

    def look(self, pan_rad: float, tilt_rad: float) -> None:
        """Turn there from this moment of simulated time on."""
        self._world.look(pan_rad, tilt_rad)

    def angles_at(self, time_s: float) -> tuple[float, float]:
        """What was asked, at its pace and with the servos' lag; the joints' true angles are not told, as in a hobby
        servo."""
        return self._world.looked_at(time_s)

    def close(self) -> None:
        """Ask for the centre. Whether time goes on for it to get there is not in this class's hands."""
        self._world.look(0.0, 0.0)
