"""What goes wrong on a rig. Every message is one sentence that names the device, what happened and what to do."""

from rhizotwin.scenes.errors import UserError


class RigError(UserError):
    """A device failed or refused; the scan that it ends can be resumed."""


class NoAnswerError(RigError):
    """A device does not answer, or answers what cannot be understood, after every retry."""


class LostError(RigError):
    """A device was reset, unplugged or released: where it stands is not known any more."""


class UnsafeError(RigError):
    """A limit was reached: temperature, voltage, a blocked joint, a place out of reach, a collision."""
