"""Who hears of a scan, and who can be asked."""

from collections.abc import Callable
from dataclasses import dataclass, field

from tqdm import tqdm

from rhizotwin.rig.scanning.homing import Ask
from rhizotwin.rig.scanning.onlooker import Onlooker
from rhizotwin.rig.scanning.safety import Say
from rhizotwin.scenes.monitor import Monitor


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
    begun: Callable[[], object] = lambda: None
    """Called once it is known that the folder can be used, before anything moves."""
