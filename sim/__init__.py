"""The twin: draws the rig's errors, renders the scene with Mitsuba and writes datasets with their truth."""
