"""A complete rig file with every key at its default, to be changed."""

EXAMPLE = """\
# A rig file of rhizotwin. Every key is here with its default: leave out what fits. Unknown keys are refused.
# Lengths are millimetres, angles degrees, times seconds. The rig's frame: origin on the table's axis in the plane of the canister's rim,
# z up, the camera on the +x side, the panel on the -x side.
name = "my_rig"
description = "arm, turntable and lights on a bench"
poses = []  # for `look NAME` in `rhizotwin rig jog`: [{name = "front", position_mm = [400.0, 0.0, -42.0], direction = [-1.0, 0.0, 0.0]}]

[turntable]  # a Marlin 2.1 board: motor and lights; its X axis is the table, in degrees
kind = "marlin"  # marlin: at this port. hat: on this Raspberry Pi's own pins, see [hat]
port = "/dev/ttyUSB0"  # better a name that stays: ls /dev/serial/by-id
baud = 115200
speed_deg_per_s = 30.0
acceleration_deg_per_s2 = 60.0  # gently: roots and water must not swing
full_step_deg = 1.8  # table angle of one full step of the motor: 1.8 / gear ratio
approach_deg = 3.6  # moves backwards go this far beyond and come back, so that play is always taken up on one side
tolerance_deg = 0.02  # between the angle commanded and the one read back
settle_s = 0.5  # rest after a move: the water must be still
rest = "given"  # measured: the scan watches how long the picture moves after a turn, and rests so long (12 s more)

[lights]  # two NeoPixel strips on the same board
panel_strip = 0  # the backlight
front_strip = 1  # the lamp over the markers
panel_rgb = [255, 255, 255]
front_rgb = [255, 255, 255]
panel_level = 1.0  # 0 to 1, during a scan
front_level = 1.0
settle_s = 0.5

[hat]  # only for turntable.kind = "hat": DRV8825 and NeoPixels on a Raspberry Pi, pins numbered as GPIO
step_pin = 23
direction_pin = 24
enable_pin = 25  # low: the motor is on
fault_pin = 22  # low: the driver is too hot, or a coil is shorted
microsteps = 32  # as MODE0 to MODE2 are wired
reverse = false
panel_pin = 18  # 12 or 18
front_pin = 13  # 13 or 19
panel_pixels = 300
front_pixels = 18

[arm]  # leave this section and [[arm.joints]] out for a camera on a tripod
protocol = "lx"  # lx: servo bus, 115200 Bd. lsc: controller board, 9600 Bd (set baud = 9600)
port = "/dev/ttyUSB1"
baud = 115200
echo = "auto"  # whether the bus adapter returns what is sent: auto, yes, no
links_mm = [61.0, 101.6, 96.4, 95.0]  # base plate to shoulder, to elbow, to wrist, to the camera's centre
position_mm = [650.0, 0.0, -50.0]  # centre of the base plate's underside
rotation_deg = [0.0, 0.0, 180.0]  # rotation vector from the arm's frame to the rig's: here it leans toward the canister
max_speed_deg_per_s = 60.0
tolerance_deg = 3.0  # between commanded and read angles, sag and dead band included
settle_s = 1.0
park_deg = [0.0, -60.0, 80.0, 70.0, 0.0]  # the place of rest: here the torque goes off, so the arm must lie safely
min_volt = 6.5
max_volt = 8.4
max_celsius = 65.0
correct = true  # look at the markers and correct the camera's place

# [arm.filter]  # the end effector's motor, where it turns a filter wheel before the lens: the keys of a joint

[[arm.joints]]  # base
servo = 6
zero_counts = 500.0  # servo position with all links in line along the base's axis
sign = 1  # -1 where the servo turns the other way
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
kind = "picamera2"  # picamera2: this Raspberry Pi's. v4l2: on USB. http: on another computer that runs 'rhizotwin camera'
address = "0"  # number of the camera (v4l2: or its device file); http: such as http://raspberrypi:8471
exposure_s = 0.01  # so that the panel reaches about 75 % of full scale: 'rhizotwin rig check' says it
gain = 1.0
colour_gains = [2.0, 2.0]  # fixed white balance: red, blue (picamera2)
white_balance_kelvin = 5000  # fixed white balance (v4l2)
bands = []  # for a scene with [[camera.bands]]: [{name = "nir", panel_level = 0.0, front_level = 0.0, output = 0}], see docs/bands.md

[clearance]  # what the arm's ways are checked against, besides the scene's canister and net pot
margin_mm = 15.0
arm_radius_mm = 32.0  # half the width of the arm's links
camera_radius_mm = 35.0  # a sphere about the camera's centre that holds it with its lens
table_radius_mm = 110.0
floor_z_mm = -195.0  # what the arm's base and the turntable's feet stand on
bars = []  # boxes that the arm must not touch: [{low_mm = [-200.0, -30.0, -190.0], high_mm = [-150.0, 30.0, 200.0]}]
"""
