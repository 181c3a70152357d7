"""The rig of an experiment with the canister that is on its table."""

from dataclasses import replace

from rhizotwin import engine, rigs
from rhizotwin.catalogue.identity import strip_for_canister
from rhizotwin.rig.scanning.homing import Ask
from rhizotwin.rig.twin.carousel import TwinCarousel
from rhizotwin.rig.twin.clock import VirtualClock
from rhizotwin.scenes import files, series
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.specimens import GrownSpecimen
from rhizotwin.timelapse.changers import CarouselChanger, Changer, EmulatedHand, PersonChanger
from rhizotwin.timelapse.experiment import Experiment, Member

SEEDS_APART = 1000
"""Scan number k has the seed `TwinPart.seed` times this plus k, so that each scan has errors of its own."""


class RealTable:
    """A real rig."""

    def __init__(self, experiment: Experiment) -> None:
        path = experiment.folder / experiment.rig
        self._bench = rigs.open_bench(str(path), None, errors=rigs.TwinErrors())

    def bench(self, scene: Scene, due_utc: str, number: int) -> tuple[rigs.Bench, None]:  # noqa: ARG002 - for the emulated rig
        """Return the rig for a scan.

        Parameters
        ----------
        scene : Scene
            Scene of the scan as a laboratory knows it.
        due_utc, number : str, int
            Not used.
        """
        return replace(self._bench, scene=scene), None


class EmulatedTable:
    """The emulated rig: the scan shows the canister that was put on its table, whichever was wanted."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self.canister = 0
        """Number of the canister on the table; 0: there is none."""
        if experiment.twin.fidelity == "render":
            engine.ensure("auto")

    def put(self, canister: int) -> None:
        """Put a canister on the table."""
        self.canister = canister

    def bench(self, scene: Scene, due_utc: str, number: int) -> tuple[rigs.Bench, rigs.TwinPictures]:
        """Return the rig for a scan, with its calibrated lens, and how the twin makes its pictures.

        Parameters
        ----------
        scene : Scene
            Scene of the scan as a laboratory knows it.
        due_utc : str
            Time at which the scan is due.
        number : int
            Number of the scan in the experiment.
        """
        part = self._experiment.twin
        pictures = rigs.TwinPictures(profile=part.profile, seed=SEEDS_APART * part.seed + number, fidelity=part.fidelity)
        there = next((one for one in self._experiment.plants if one.canister == self.canister), None)
        if there is not None:
            true = true_scene(self._experiment, there, due_utc)
        else:  # a canister that belongs to no plant of the experiment, or none
            base = self._experiment.base_scene()
            strip = strip_for_canister(base.strip, self.canister) if self.canister else replace(base.strip, rows=0)
            true = replace(scene, strip=strip, specimen=base.specimen)
        bench = rigs.twin_bench(replace(true, disturbances=files.load_profile(part.profile)), pictures)
        return replace(bench, scene=replace(scene, camera=bench.scene.camera)), pictures


def true_scene(experiment: Experiment, member: Member, due_utc: str) -> Scene:
    """Return the scene of a canister on the emulated rig, with its plant as it has grown by then.

    The plants of a grown scene have seeds of their own; sketches show no roots, so that no growth is computed for them.
    """
    known = experiment.known_scene(member, due_utc)
    own = experiment.base_scene() if not member.scene else files.load_scene(member.scene)
    if own.plants:  # such as the wires of a phantom, which are one member of the experiment
        return replace(known, specimen=None, plants=own.plants, subject=replace(known.subject, plant=""))
    if experiment.twin.fidelity == "sketch" or not isinstance(own.specimen, GrownSpecimen):
        return replace(known, specimen=own.specimen)
    from rhizotwin.sim.growth import grow

    like = own.specimen
    if not member.scene:
        own = series.replicate(own, experiment.plants.index(member))
    own = series.apply_treatment(own, member.treatment, member.growth)
    grown = series.at_day(own, experiment.day(member, due_utc), grow=grow, like=like)
    return replace(known, specimen=grown.specimen)


def changer_of(experiment: Experiment, table: RealTable | EmulatedTable, *, ask: Ask | None) -> Changer:
    """Return who puts the canisters on the table.

    Parameters
    ----------
    experiment : Experiment
        Its schedule says who.
    table : RealTable or EmulatedTable
        The rig.
    ask : callable or None
        Asks a person.

    Raises
    ------
    UserError
        For a carousel on a real rig, for which there is no driver yet.
    """
    if isinstance(table, EmulatedTable):
        if experiment.schedule.change == "person":
            return EmulatedHand(table.put)
        places = list(range(1, max(one.canister for one in experiment.plants) + 1))
        return CarouselChanger(TwinCarousel(VirtualClock(), places, table.put))
    if experiment.schedule.change == "carousel":
        raise UserError(
            f'{experiment.file}: [schedule] change = "carousel" needs the driver of a carousel (rig.devices.Carousel), and this '
            'program has the emulated one only; use change = "person", or give a driver from Python'
        )
    return PersonChanger(ask)
