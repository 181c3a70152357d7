"""Complete rig file with every key at its default, as a template."""

EXAMPLE = """\
# Rig file of rhizotwin with every key at its default; keys with suitable defaults can be removed. Unknown keys are rejected.
# Lengths are in millimetres, angles in degrees, times in seconds. Rig frame: origin on the table's axis in the plane of the canister's rim,
# z up, the camera on the +x side, the panel on the -x side.
name = "my_rig"
description = "arm, turntable and lights on a bench"
poses = []  # for `look NAME` in `rhizotwin rig jog`: [{name = "front", position_mm = [400.0, 0.0, -42.0], direction = [-1.0, 0.0, 0.0]}]

[turntable]  # a Marlin 2.1 board: motor and lights; its X axis is the table, in degrees
kind = "marlin"  # marlin: board at this port. hat: pins of this Raspberry Pi, see [hat]
port = "/dev/ttyUSB0"  # preferably a persistent name: ls /dev/serial/by-id
baud = 115200
speed_deg_per_s = 30.0
acceleration_deg_per_s2 = 60.0  # low, so that roots and water do not swing
full_step_deg = 1.8  # table angle of one full step of the motor: 1.8 / gear ratio
approach_deg = 3.6  # backward moves overshoot by this angle and return, so that backlash is always on the same side
tolerance_deg = 0.02  # maximum difference between commanded and measured angle
settle_s = 0.5  # pause after a move, until the water is still
rest = "given"  # measured: the scan measures the time until the picture is still after a turn, and pauses for that time (takes 12 s more)

[lights]  # two NeoPixel strips on the same board
panel_strip = 0  # strip of the backlight
front_strip = 1  # strip of the lamp above the markers
panel_rgb = [255, 255, 255]
front_rgb = [255, 255, 255]
panel_level = 1.0  # 0 to 1, during a scan
front_level = 1.0
settle_s = 0.5

[hat]  # only for turntable.kind = "hat": DRV8825 and NeoPixels on a Raspberry Pi, pins numbered as GPIO
step_pin = 23
direction_pin = 24
enable_pin = 25  # low switches the motor on
fault_pin = 22  # low signals a hot driver or a shorted coil
microsteps = 32  # according to the wiring of MODE0 to MODE2
reverse = false
panel_pin = 18  # 12 or 18
front_pin = 13  # 13 or 19
panel_pixels = 300
front_pixels = 18

[arm]  # remove this section and [[arm.joints]] for a camera on a tripod
protocol = "lx"  # lx: servo bus, 115200 Bd. lsc: controller board, 9600 Bd (set baud = 9600)
port = "/dev/ttyUSB1"
baud = 115200
echo = "auto"  # whether the bus adapter echoes transmitted bytes: auto, yes, no
links_mm = [61.0, 101.6, 96.4, 95.0]  # base plate to shoulder, to elbow, to wrist, to the camera's centre
position_mm = [650.0, 0.0, -50.0]  # centre of the base plate's underside
rotation_deg = [0.0, 0.0, 180.0]  # rotation vector from the arm's frame to the rig's: here the arm leans toward the canister
max_speed_deg_per_s = 60.0
tolerance_deg = 3.0  # maximum difference between commanded and measured angles, including sag and dead band
settle_s = 1.0
park_deg = [0.0, -60.0, 80.0, 70.0, 0.0]  # parking position, in which the torque is switched off and the arm must be supported
min_volt = 6.5
max_volt = 8.4
max_celsius = 65.0
correct = true  # correct the camera's position by the markers

# [arm.filter]  # end effector's motor, if it rotates a filter wheel in front of the lens; keys as for a joint

[[arm.joints]]  # base
servo = 6
zero_counts = 500.0  # servo position with all links aligned along the base's axis
sign = 1  # -1 if the servo rotates in the opposite direction
counts_per_deg = 4.166666666666667  # 1000 / 240
min_deg = -90.0
max_deg = 90.0

[[arm.joints]]  # shoulder
servo = 5
zero_counts = 500.0
sign = 1
counts_per_deg = 4.166666666666667
min_deg = -86.0
max_deg = 91.0

[[arm.joints]]  # elbow
servo = 4
zero_counts = 500.0
sign = 1
counts_per_deg = 4.166666666666667
min_deg = -88.0
max_deg = 88.0

[[arm.joints]]  # wrist pitch
servo = 3
zero_counts = 500.0
sign = 1
counts_per_deg = 4.166666666666667
min_deg = -112.0
max_deg = 112.0

[[arm.joints]]  # wrist roll
servo = 2
zero_counts = 500.0
sign = 1
counts_per_deg = 4.166666666666667
min_deg = -112.0
max_deg = 112.0

[camera]
kind = "picamera2"  # picamera2: this Raspberry Pi's. v4l2, gphoto2: on USB. http: on another computer that runs 'rhizotwin camera'
address = "0"  # number of the camera (v4l2: or its device file; gphoto2: or its port); http: such as http://raspberrypi:8471
exposure_s = 0.01  # the panel should reach about 75 % of full scale, see 'rhizotwin rig check'
gain = 1.0  # gphoto2: the ISO divided by 100
colour_gains = [2.0, 2.0]  # fixed white balance: red, blue (picamera2, gphoto2)
white_balance_kelvin = 5000  # fixed white balance (v4l2)
trigger = "usb"  # gphoto2: usb, or board if the table's board is connected to the shutter input, see docs/camera.md
bands = []  # for a scene with [[camera.bands]]: [{name = "nir", panel_level = 0.0, front_level = 0.0, output = 0}], see docs/bands.md

[clearance]  # obstacles of the arm, in addition to the scene's canister and net pot
margin_mm = 15.0
arm_radius_mm = 32.0  # half the width of the arm's links
camera_radius_mm = 35.0  # radius of a sphere about the camera's centre that encloses camera and lens
table_radius_mm = 110.0
floor_z_mm = -195.0  # surface on which the arm's base and the turntable stand
bars = []  # boxes that the arm must avoid: [{low_mm = [-200.0, -30.0, -190.0], high_mm = [-150.0, 30.0, 200.0]}]
"""
