"""What is on the rig: frozen, validated descriptions, and the files that carry them."""
