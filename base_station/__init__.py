"""The base station on a PC: watches the robot's frames with a tracker and answers with wheel speeds."""

__version__ = "0.1.0"
