"""Real or emulated rig of an experiment, with the canister that is on its turntable."""

from dataclasses import replace

from rhizotwin import engine
from rhizotwin.catalogue.identity import strip_for_canister
from rhizotwin.rig.scanning.homing import Ask
from rhizotwin.rig.twin.carousel import TwinCarousel
from rhizotwin.rig.twin.clock import VirtualClock
from rhizotwin.scenes import series
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.specimens import GrownSpecimen
from rhizotwin.scenes.subject import Subject
from rhizotwin.steps import rigs
from rhizotwin.timelapse.changers import CarouselChanger, Changer, EmulatedHand, PersonChanger
from rhizotwin.timelapse.experiment import Experiment, Member

SEEDS_APART = 1000
"""Factor by which the seed of the experiment is multiplied before the number of a scan is added. The scans of an
experiment thus have different seeds."""


class RealTable:
    """Turntable of a real rig."""

    def __init__(self, experiment: Experiment) -> None:
        path = experiment.folder / experiment.rig
        self._bench = rigs.open_bench(str(path), None, errors=rigs.TwinErrors())

    def bench(self, scene: Scene, _number: int, /) -> rigs.Bench:
        """Return the rig with the scene of a scan.

        Parameters
        ----------
        scene : Scene
            Nominal scene of the scan.
        _number : int
            Number of the scan, which a real rig ignores.
        """
        return replace(self._bench, scene=scene)


class EmulatedTable:
    """Turntable of the emulated rig.

    A scan shows the canister that was placed on it, even if it is not the canister of the plant to be scanned.
    """

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self.canister = 0
        """Number of the canister on the turntable. It is 0 if the turntable is empty."""
        if experiment.twin.fidelity == "render":
            engine.ensure("auto")

    def put(self, canister: int) -> None:
        """Place a canister on the turntable."""
        self.canister = canister

    def bench(self, scene: Scene, number: int, /) -> rigs.Bench:
        """Return the emulated rig for a scan, with its calibrated lens.

        Parameters
        ----------
        scene : Scene
            Nominal scene of the scan.
        number : int
            Number of the scan in the experiment.
        """
        part = self._experiment.twin
        pictures = rigs.TwinPictures(profile=part.profile, seed=SEEDS_APART * part.seed + number, fidelity=part.fidelity)
        there = next((one for one in self._experiment.plants if one.canister == self.canister), None)
        if there is not None:
            true = true_scene(self._experiment, there, scene.subject)
        else:  # no canister, or a canister without a plant of the experiment
            base = self._experiment.base_scene()
            strip = strip_for_canister(base.strip, self.canister) if self.canister else replace(base.strip, rows=0)
            true = replace(scene, strip=strip, specimen=base.specimen)
        bench = rigs.twin_bench(replace(true, plan=scene.plan, disturbances=self._experiment.disturbances()), pictures)
        return replace(bench, scene=replace(scene, camera=bench.scene.camera))


def true_scene(experiment: Experiment, member: Member, expected: Subject) -> Scene:
    """Return the true scene of a canister on the emulated rig.

    The plant has grown to its age at the scan of the expected plant. Simulated plants of the experiment are grown from
    different seeds. Growth is not simulated for sketches, because they do not show the plant.
    """
    older = (experiment.sown(experiment.member(expected.plant)) - experiment.sown(member)).days
    day = max(0.0, (expected.day or 0.0) + older)
    known = experiment.scene_at(member, day=day, date=expected.date)
    own = experiment.specimen_scene(member)
    if own.plants:  # for example the wires of a phantom, which is one member of the experiment
        return replace(known, specimen=None, plants=own.plants, subject=replace(known.subject, plant=""))
    if experiment.twin.fidelity == "sketch" or not isinstance(own.specimen, GrownSpecimen):
        return replace(known, specimen=own.specimen)
    from rhizotwin.sim.growth import grow

    like = own.specimen
    if not member.scene:
        own = series.replicate(own, experiment.plants.index(member))
    own = series.apply_treatment(own, member.treatment, member.growth)
    grown = series.at_day(own, day, grow=grow, like=like)
    return replace(known, specimen=grown.specimen)


def changer_of(experiment: Experiment, table: RealTable | EmulatedTable, *, ask: Ask | None) -> Changer:
    """Return the device or person that places canisters on the turntable.

    Parameters
    ----------
    experiment : Experiment
        Experiment whose schedule specifies a person or a carousel.
    table : RealTable or EmulatedTable
        Turntable of the rig.
    ask : callable or None
        Function that asks the user a question; None if no user is available.

    Raises
    ------
    UserError
        If the schedule specifies a carousel on a real rig, because no driver is available.
    """
    if isinstance(table, EmulatedTable):
        if experiment.schedule.change == "person":
            return EmulatedHand(table.put)
        places = list(range(1, max(one.canister for one in experiment.plants) + 1))
        return CarouselChanger(TwinCarousel(VirtualClock(), places, table.put))
    if experiment.schedule.change == "carousel":
        raise UserError(
            f'{experiment.file}: [schedule] change = "carousel" needs a carousel driver (rig.devices.Carousel), but this '
            'program has only an emulated carousel; use change = "person", or provide a driver in Python'
        )
    return PersonChanger(ask)
