"""Complete rig file with every key at its default, as a starting point."""

EXAMPLE = """\
# Rig file of rhizotwin with all keys and their defaults. Keys with their default value can be removed. Unknown keys are rejected.
# Lengths in millimetres, angles in degrees, times in seconds. Rig frame: origin on the turntable axis in the plane of the canister's rim,
# z up, the camera on the +x side, the panel on the -x side.
name = "my_rig"
description = "arm, turntable and lights on a bench"
poses = []  # for `look NAME` in `rhizotwin rig jog`: [{name = "front", position_mm = [400.0, 0.0, -42.0], direction = [-1.0, 0.0, 0.0]}]

[turntable]  # a Marlin 2.1 board: motor and lights; its X axis is the table, in degrees
kind = "marlin"  # marlin: board at this port. hat: pins of this Raspberry Pi, see [hat]
port = "/dev/ttyUSB0"  # names in /dev/serial/by-id do not change when reconnected
baud = 115200
speed_deg_per_s = 30.0
acceleration_deg_per_s2 = 60.0  # slow, so that roots and water do not swing
full_step_deg = 1.8  # table angle of one full step of the motor: 1.8 / gear ratio
approach_deg = 3.6  # overshoot of backward moves, so that backlash is always taken up on one side
tolerance_deg = 0.02  # maximum difference between commanded and read angle
settle_s = 0.5  # waiting time after a move, for the water to come to rest
rest = "given"  # measured: the scan measures how long the picture moves after a rotation, and waits accordingly (takes 12 s more)

[lights]  # two NeoPixel strips on the same board
panel_strip = 0  # the backlight
front_strip = 1  # lamp above the markers
panel_rgb = [255, 255, 255]
front_rgb = [255, 255, 255]
panel_level = 1.0  # 0 to 1, during a scan
front_level = 1.0
settle_s = 0.5

[hat]  # only for turntable.kind = "hat": DRV8825 and NeoPixels on a Raspberry Pi, GPIO numbers
step_pin = 23
direction_pin = 24
enable_pin = 25  # low: the motor is on
fault_pin = 22  # low: the driver is too hot, or a coil is shorted
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
echo = "auto"  # whether the bus adapter echoes sent data: auto, yes, no
links_mm = [61.0, 101.6, 96.4, 95.0]  # base plate to shoulder, to elbow, to wrist, to the projection centre of the camera
position_mm = [650.0, 0.0, -50.0]  # centre of the lower face of the base plate
rotation_deg = [0.0, 0.0, 180.0]  # rotation vector from the arm frame to the rig frame: here facing the canister
max_speed_deg_per_s = 60.0
tolerance_deg = 3.0  # maximum difference between commanded and read angles, including sag and dead band
settle_s = 1.0
park_deg = [0.0, -60.0, 80.0, 70.0, 0.0]  # parking position: the servos are unpowered here, so that the arm must rest safely
min_volt = 6.5
max_volt = 8.4
max_celsius = 65.0
correct = true  # correct the camera position by the markers

# [arm.filter]  # the end effector's motor, where it turns a filter wheel before the lens: the keys of a joint

[[arm.joints]]  # base
servo = 6
zero_counts = 500.0  # servo position with all links in line along the base's axis
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
kind = "picamera2"  # picamera2: Raspberry Pi. v4l2: USB. http: another computer that runs 'rhizotwin camera'
address = "0"  # number of the camera (v4l2: or its device file); http: such as http://raspberrypi:8471
exposure_s = 0.01  # panel at about 75 % of full scale, see 'rhizotwin rig check'
gain = 1.0
colour_gains = [2.0, 2.0]  # fixed white balance: red, blue (picamera2)
white_balance_kelvin = 5000  # fixed white balance (v4l2)
bands = []  # for a scene with [[camera.bands]]: [{name = "nir", panel_level = 0.0, front_level = 0.0, output = 0}], see docs/bands.md

[clearance]  # obstacles for the arm, in addition to canister and net pot of the scene
margin_mm = 15.0
arm_radius_mm = 32.0  # half the width of the links
camera_radius_mm = 35.0  # sphere around the projection centre that contains camera and lens
table_radius_mm = 110.0
floor_z_mm = -195.0  # height of the floor below arm and turntable
bars = []  # boxes that the arm must not touch: [{low_mm = [-200.0, -30.0, -190.0], high_mm = [-150.0, 30.0, 200.0]}]
"""
