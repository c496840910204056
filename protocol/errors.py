"""The two ways in which bytes from outside can be wrong."""


class ProtocolError(ValueError):
    """The peer sent something that the wire does not allow. The text says what, in words for a person."""


class TruncatedError(ProtocolError):
    """The stream ended in the middle of an item: the peer sent a part of it and went."""
