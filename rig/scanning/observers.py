"""Set of a scan's observers and user callbacks."""

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
    """Observers of a scan, and callbacks for its user."""

    ask: Ask | None = None
    """Function that asks the user a question. It is None if there is no user."""
    table_angle_deg: float | None = None
    """Present table angle given by the user, deg, which is used if the strip cannot be read at the start."""
    say: Say = tqdm.write
    """Function that receives messages for the user."""
    observer: Observer = field(default_factory=Observer)
    """Observer that is notified of every picture, and can pause the scan."""
    monitor: Monitor = field(default_factory=Monitor)
    """Receiver of progress reports."""
    identify: Callable[[Grey], object] = lambda _: None
    """Function that checks which canister is on the table. It is called with the first picture of a run, before
    anything is recorded. An exception raised by this function ends the scan."""
    begun: Callable[[], object] = lambda: None
    """Function that is called after the folder was checked, and before any motion."""
