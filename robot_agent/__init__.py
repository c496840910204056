"""The thin agent on the robot: streams gray frames, obeys wheel commands, keeps the robot safe."""

__version__ = "0.1.0"
