"""An emulated rig: devices with physical errors, and a camera that shows their true state.

The devices use the same protocols as the real ones.

Layers, each of which depends only on those listed before it:

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
