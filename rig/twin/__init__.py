"""Emulated rig: devices with physical errors, and a camera that renders their true state.

The devices use the protocols of the real ones.

Layers, each of which knows only those listed before it:

clock, imperfections, servo, stepper,  device models in virtual time; no protocol lamps world
true state of the devices in the rig frame adapter, marlin_commands,              bytes in, bytes with due times out; no
physics marlin_adapter, lx_adapter, lsc_adapter faults, line                           a serial line with its wire time
and its faults protocol_twin, pty_ports               the line as a pyserial URL in virtual time, or behind
pseudo-terminals sketch, pictures, camera, record       pictures of the world, drawn quickly or rendered by `sim`; its
truth twin, server                           complete emulated rig, within this process or standalone
"""
