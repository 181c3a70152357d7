"""Errors of a rig. Every message names the device, the problem and a remedy."""

from rhizotwin.scenes.errors import UserError


class RigError(UserError):
    """Raised if a device fails or rejects a command. The scan can be resumed."""


class NoAnswerError(RigError):
    """Raised if a device does not reply, or replies invalidly, after all retries."""


class LostError(RigError):
    """Raised if a device was reset, unplugged or released, so that its position is unknown."""


class UnsafeError(RigError):
    """Raised if a limit is exceeded: temperature, voltage, a blocked joint, a position out of reach, or a collision."""
