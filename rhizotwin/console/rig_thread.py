"""The thread that uses the rig's devices: one command, check, live picture or scan at a time."""

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

if TYPE_CHECKING:
    from rhizotwin.rigs import Bench
    from rhizotwin.scenes.picture_codec import Grey

T = TypeVar("T")

LIVE_S = 1.0
"""Interval between live pictures (s)."""


class RigThread:
    """Runs actions on the rig, one at a time and in one thread.

    The devices are opened for the first command and stay open for the next; `let_go` leaves them safe and closes them.

    Parameters
    ----------
    bench : Bench
        The rig.
    say : callable
        Receives lines for people.
    on_live : callable
        Receives each live picture.
    on_error : callable
        Receives each error of an action or a live picture, before the action ends.
    on_change : callable
        Called when an action begins or ends.
    """

    def __init__(
        self,
        bench: Bench,
        *,
        say: Callable[[str], None],
        on_live: Callable[[Grey], object],
        on_error: Callable[[Exception], object],
        on_change: Callable[[], object],
    ) -> None:
        self._bench = bench
        self._say = say
        self._on_live, self._on_error, self._on_change = on_live, on_error, on_change
        self._stack: ExitStack | None = None
        self._jog: Jog | None = None
        self._wake = threading.Condition()
        self._next: tuple[Callable[[], Any], Future[Any]] | None = None
        self._ended = False
        self.busy = ""
        """Description of the current action; empty when there is none."""
        self.live_until_s = 0.0
        """Live pictures are taken until this time (`time.monotonic`)."""
        # no daemon: the program ends only when the rig has been left safe
        self._thread = threading.Thread(target=self._run, name="rig", daemon=False)
        self._thread.start()

    @property
    def open(self) -> bool:
        """Whether devices are open for commands."""
        return self._jog is not None

    def begin(self, what: str, action: Callable[[], T]) -> Future[T]:
        """Start an action.

        Parameters
        ----------
        what : str
            Description, such as "scan of P7".
        action : callable
            Runs in the rig's thread.

        Raises
        ------
        UserError
            While another action runs.
        """
        future: Future[T] = Future()
        with self._wake:
            if self._ended:
                raise UserError("the console is being stopped")
            if self.busy:
                raise UserError(f"the rig is busy: {self.busy}; wait until it has ended, or stop it")
            self.busy = what
            self._next = action, future
            self._wake.notify_all()
        self._on_change()
        return future

    def jog(self) -> Jog:
        """Return the open devices for commands, opened if necessary; call from the rig thread only."""
        if self._jog is None:
            stack = ExitStack()
            try:
                devices = self._bench.open_devices(None, stack)
            except BaseException:
                stack.close()
                raise
            self._stack, self._jog = stack, Jog(devices, self._bench.scene, say=self._say)
        return self._jog

    def command(self, words: list[str]) -> None:
        """Execute a command of `rig.jog`; call from the rig thread only."""
        with self._closed_if_lost():
            self.jog().do(words)

    def let_go(self) -> None:
        """Leave the devices safe (lights off, arm parked, torque off) and close them; call from the rig thread only."""
        stack, jog = self._stack, self._jog
        self._stack = self._jog = None
        if stack is not None and jog is not None:
            with stack:
                jog.leave()

    def close(self) -> None:
        """Wait for the current action, leave the devices safe and end the thread."""
        with self._wake:
            self._ended = True
            self._wake.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._wake:
                if self._next is None and not self._ended:
                    self._wake.wait(LIVE_S)
                following, self._next = self._next, None
                if following is None and self._ended:
                    break
            if following is not None:
                self._do(*following)
            elif time.monotonic() < self.live_until_s:
                self._take_live()
        self.let_go()

    def _do(self, action: Callable[[], Any], future: Future[Any]) -> None:
        try:
            result, error = action(), None
        except BaseException as raised:  # noqa: BLE001 - whoever waits for the future gets it
            result, error = None, raised
            if isinstance(raised, Exception):
                self._on_error(raised)
        with self._wake:
            self.busy = ""
        self._on_change()
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)

    def _take_live(self) -> None:
        try:
            with self._closed_if_lost():
                self._on_live(self.jog().shot())
        except Exception as error:  # noqa: BLE001 - reported; the thread goes on, and leaves the rig safe at the end
            self.live_until_s = 0.0
            self._on_error(error)
            self._on_change()

    @contextmanager
    def _closed_if_lost(self) -> Iterator[None]:
        """Close devices that no longer respond, so that the next command opens them again."""
        try:
            yield
        except (NoAnswerError, LostError):
            self.let_go()
            raise
