"""Failures of the agent that a person can mend."""


class AgentError(Exception):
    """Something the person at the keyboard can mend. The text is one sentence: what happened, then what to do."""


class UsageError(AgentError):
    """A mistake on the command line (exit code 2): starting the same again cannot help."""


class CameraError(AgentError):
    """The camera is not there, or it broke."""


class PanTiltError(AgentError):
    """The pan-tilt's servos cannot be reached."""


class EndOfRecording(AgentError):
    """A replay camera has shown its last frame."""
