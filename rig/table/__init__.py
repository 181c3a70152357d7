"""Controller of turntable and lamps with Marlin firmware: protocol, angles and lamp levels."""
