"""Errors of a rig. Every message is one sentence with the device, the problem and a remedy."""

from rhizotwin.scenes.errors import UserError


class RigError(UserError):
    """A device failed or rejected a command; the scan can be resumed."""


class NoAnswerError(RigError):
    """A device does not answer, or its answers are invalid, after every retry."""


class LostError(RigError):
    """A device was reset, unplugged or released, so that its position is unknown."""


class UnsafeError(RigError):
    """A limit was reached: temperature, voltage, a blocked joint, a position out of reach, a collision."""
