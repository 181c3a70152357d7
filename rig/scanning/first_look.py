"""One picture before a scan, from which the canister on the table is identified."""

from rhizotwin.rig import bands
from rhizotwin.rig.open import Devices
from rhizotwin.rig.scanning import preflight
from rhizotwin.rig.scanning.arm_stand import ArmStand
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.safety import ArmState, BoardState, make_safe
from rhizotwin.rig.scanning.scan_camera import ScanCamera
from rhizotwin.rig.scanning.stand import Stand, Tripod
from rhizotwin.scenes import plan
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey


def take_first_look(devices: Devices, scene: Scene, observers: Observers) -> Grey:
    """Light the canister, place the camera for the first ring, and take one picture. The rig is left in a safe state.

    Parameters
    ----------
    devices : Devices
        Open devices, which remain open.
    scene : Scene
        Scene with rig and plan. The marker ids of its strip are not used.
    observers : Observers
        Receiver of messages. For a rig without an arm, it also asks the user to place the camera.

    Returns
    -------
    (H, W) uint8 or uint16 array
        Picture of the canister.

    Raises
    ------
    RigError
        If a device fails.
    """

    def note(_: str, text: str) -> None:
        observers.say(text)

    ring, main = scene.plan.rings[0], plan.main_band(scene, 0)
    camera = ScanCamera(devices.camera, devices.clock, scene, note=note)
    stand: Stand = Tripod(scene, camera, ask=observers.ask, note=note)
    if devices.arm is not None and devices.rig.arm is not None:
        stand = ArmStand(devices, devices.arm, devices.rig.arm, camera, note=note)
    stand.check_rings([ring])
    used = False
    try:
        preflight.check_table(devices.table)
        bands.light(devices.lights, devices.rig, main)
        if devices.arm is not None:
            used = True
            preflight.check_arm(devices.arm)
            bands.turn_filter(devices.arm, devices.rig, main)
        preflight.check_camera(devices.camera)
        stand.place(ring)
        shot, _ = stand.search()
        preflight.check_picture(shot.image, scene.camera)
        return shot.image
    finally:
        make_safe(devices, scene, BoardState(used=True), ArmState(used=used, failed=stand.failed), say=observers.say)
