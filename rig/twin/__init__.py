"""Emulated rig.

It consists of devices with physical errors that use the real protocols, and of a camera that shows their true state.
Drivers and scans use the emulated devices in the same way as real devices.

Each layer depends only on the layers listed before it:

clock, imperfections, servo, stepper,  device models in virtual time, without protocols
lamps
world                                  true state of the devices, in the rig's frame
adapter, marlin_commands,              protocols: bytes in, bytes with due times out, without physics
marlin_adapter, lx_adapter, lsc_adapter
faults, line                           serial line with transmission times and faults
protocol_twin, pty_ports               the line as a pyserial URL in virtual time, or as a pseudo-terminal
sketch, pictures, camera, record       pictures of the world, drawn quickly or rendered by `sim`, and its truth
twin, server                           the complete twin, within this process or as a server
"""
