"""Who hears of a scan, and who can be asked."""

from collections.abc import Callable
from dataclasses import dataclass, field

from tqdm import tqdm

from rhizotwin.rig.scanning.homing import Ask
from rhizotwin.rig.scanning.onlooker import Onlooker
from rhizotwin.rig.scanning.safety import Say
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.pictures import Grey


@dataclass(frozen=True, kw_only=True)
class Audience:
    """Those beside the devices who have to do with a scan."""

    ask: Ask | None = None
    """Puts a question to a person; None when nobody is there."""
    say: Say = tqdm.write
    """Takes lines for people."""
    onlooker: Onlooker = field(default_factory=Onlooker)
    """Hears what every picture shows, and may hold the scan."""
    monitor: Monitor = field(default_factory=Monitor)
    """Hears how far the scan is."""
    identify: Callable[[Grey], object] = lambda _: None
    """Called with the first picture of a run, before anything is recorded, to check which canister is on the table; an
    exception that it raises ends the scan."""
    begun: Callable[[], object] = lambda: None
    """Called once it is known that the folder can be used, before anything moves."""
