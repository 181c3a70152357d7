"""Observers of a scan, and callbacks to the user."""

from collections.abc import Callable
from dataclasses import dataclass, field

from tqdm import tqdm

from rhizotwin.rig.scanning.homing import Ask
from rhizotwin.rig.scanning.observer import Observer
from rhizotwin.rig.scanning.safety import Say
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.picture_codec import Grey


@dataclass(frozen=True, kw_only=True)
class Observers:
    """Observers and callbacks of a scan."""

    ask: Ask | None = None
    """Asks the user a question; None if there is no user."""
    say: Say = tqdm.write
    """Receives lines for the user."""
    observer: Observer = field(default_factory=Observer)
    """Receives the contents of every picture, and can pause the scan."""
    monitor: Monitor = field(default_factory=Monitor)
    """Receives the progress of the scan."""
    identify: Callable[[Grey], object] = lambda _: None
    """Called with the first picture of a run, before anything is recorded, to check which canister is on the table; an
    exception that it raises ends the scan."""
    begun: Callable[[], object] = lambda: None
    """Called when the folder is known to be usable, before any motion."""
