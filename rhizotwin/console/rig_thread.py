"""Thread that performs all actions on the devices of the rig one after another.

An action is a command, a check, a live picture or a scan.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from rhizotwin.rig.errors import LostError, NoAnswerError
from rhizotwin.rig.jog import Jog
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.threads import LastingThread

if TYPE_CHECKING:
    from rhizotwin.scenes.picture_codec import Grey
    from rhizotwin.steps.rigs import Bench

T = TypeVar("T")

LIVE_S = 1.0
"""Interval between live pictures, s."""


class RigThread:
    """Runs actions on the rig in a single thread, one at a time.

    The devices are opened for the first command and remain open. `let_go` brings them to a safe state and closes them.

    Parameters
    ----------
    bench : Bench
        Rig with its scene.
    say : callable
        Function that is called with each line of output.
    on_live : callable
        Function that is called with each live picture.
    on_error : callable
        Function that is called with each error of an action, live picture or the thread, before the action ends.
    on_change : callable
        Function that is called when an action starts or ends.
    """

    def __init__(
        self,
        bench: Bench,
        *,
        say: Callable[[str], None],
        on_live: Callable[[Grey], object],
        on_error: Callable[[BaseException], object],
        on_change: Callable[[], object],
    ) -> None:
        self._bench = bench
        self.say = say
        """Function that is called with each line of output."""
        self._replies: list[str] = []
        self._on_live, self._on_error, self._on_change = on_live, on_error, on_change
        self._stack: ExitStack | None = None
        self._jog: Jog | None = None
        self._wake = threading.Condition()
        self._next: tuple[Callable[[], Any], Future[Any]] | None = None
        self._doing: Future[Any] | None = None
        self._ended = False
        self.busy = ""
        """Description of the current action. It is empty if the rig is idle."""
        self.live_until_s = 0.0
        """Time at which live pictures end, in seconds on the clock `time.monotonic`."""
        # not a daemon thread, so that the program ends only after the rig is in a safe state
        self._thread = LastingThread(self._run, name="rig", on_error=on_error, daemon=False)

    @property
    def open(self) -> bool:
        """Whether devices are open for commands."""
        return self._jog is not None

    def begin(self, what: str, action: Callable[[], T]) -> Future[T]:
        """Start an action in the rig's thread.

        Parameters
        ----------
        what : str
            Description of the action for the user, such as "scan of P7".
        action : callable
            Function to call.

        Returns
        -------
        Future
            Future with the return value of the function.

        Raises
        ------
        UserError
            If another action is running.
        """
        future: Future[T] = Future()
        with self._wake:
            if self._ended:
                raise UserError("the console is shutting down and accepts no further actions")
            if self.busy:
                raise UserError(f"the rig is busy ({self.busy}); wait until this action has ended, or stop it")
            self.busy = what
            self._next = action, future
            self._wake.notify_all()
        self._on_change()
        return future

    def jog(self) -> Jog:
        """Return the devices, which are opened if necessary. The method must be called in the rig's thread."""
        if self._jog is None:
            stack = ExitStack()
            try:
                devices = self._bench.open_devices(None, stack)
            except BaseException:
                stack.close()
                raise
            self._stack, self._jog = stack, Jog(devices, self._bench.scene, say=self._reply)
        return self._jog

    def command(self, words: list[str]) -> list[str]:
        """Execute a command of `rig.jog`, and return its output. The method must be called in the rig's thread."""
        self._replies = []
        with self._closed_if_lost():
            self.jog().do(words)
        return self._replies

    def _reply(self, line: str) -> None:
        self._replies.append(line)
        self.say(line)

    def set_live(self, until_s: float) -> None:
        """Set the time at which live pictures end. They end at once if it is 0."""
        self.live_until_s = until_s
        self._on_change()

    def let_go(self) -> None:
        """Switch off the lights, park the arm, switch off its torque and close the devices.

        The method must be called in the rig's thread.
        """
        stack, jog = self._stack, self._jog
        self._stack = self._jog = None
        if stack is not None and jog is not None:
            with stack:
                jog.leave()

    def close(self) -> None:
        """Wait for the current action, bring the devices to a safe state, and end the thread."""
        with self._wake:
            self._ended = True
            self._wake.notify_all()
        self._thread.join()

    def _run(self) -> None:
        if self._doing is not None:  # this thread goes on after an exception that was not one of the action
            self._end(self._doing, None, RuntimeError(f"{self.busy} was interrupted"))
        while True:
            with self._wake:
                if self._next is None and not self._ended:
                    self._wake.wait(LIVE_S)
                following = self._next
                self._next = None
                self._doing = None if following is None else following[1]
                if following is None and self._ended:
                    break
            if following is not None:
                self._do(*following)
            elif time.monotonic() < self.live_until_s:
                self._take_live()
        self.let_go()

    def _do(self, action: Callable[[], Any], future: Future[Any]) -> None:
        try:
            result = action()
            error = None
        except BaseException as raised:  # noqa: BLE001 - passed on through the future
            result = None
            error = raised
            if not isinstance(raised, KeyboardInterrupt):  # the action was stopped by a user
                self._on_error(raised)
        self._end(future, result, error)

    def _end(self, future: Future[Any], result: Any, error: BaseException | None) -> None:
        with self._wake:
            self.busy = ""
            self._doing = None
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)
        self._on_change()

    def _take_live(self) -> None:
        try:
            with self._closed_if_lost():
                self._on_live(self.jog().shot())
        except Exception as error:  # noqa: BLE001 - reported, while the thread continues
            self.live_until_s = 0.0
            self._on_error(error)
            self._on_change()

    @contextmanager
    def _closed_if_lost(self) -> Iterator[None]:
        """Close the devices if one of them no longer responds, so that the next command opens them again."""
        try:
            yield
        except (NoAnswerError, LostError):
            self.let_go()
            raise
