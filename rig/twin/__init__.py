"""An emulated rig: devices with physical errors, the bytes that the real ones speak, and a camera that looks at what they have really done.

Layers, none of which knows the one above it:

imperfections, servo, stepper, lamps   device models in virtual time; no protocol
world                                  what the devices have really done, in the rig's frame
adapter, marlin_adapter, lx_adapter,   bytes in, bytes with due times out; no physics
lsc_adapter
faults, line                           a serial line with its wire time and its faults
protocol_twin, pty_ports               the line as a pyserial URL in virtual time, or behind pseudo-terminals in real time
sketch, pictures, camera               pictures of the world, drawn quickly or rendered by `sim`, behind the camera's interface
twin, server                           all of it together, within this process or alone
"""
