"""Time for the tests of the rig."""


class Time:
    """Time that passes only when somebody waits, with what was waited for."""

    def __init__(self) -> None:
        self.at_s = 0.0
        self.slept: list[float] = []

    def now_s(self) -> float:
        """Return the time."""
        return self.at_s

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.slept.append(seconds)
        self.at_s += max(seconds, 0.0)
