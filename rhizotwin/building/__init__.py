"""A rig that can be built from its files: printed parts, their drawings, and the wiring."""
