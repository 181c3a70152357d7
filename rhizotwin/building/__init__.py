"""Parts of a rig for 3D printing, with drawings and wiring diagrams."""
