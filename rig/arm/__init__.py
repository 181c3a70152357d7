"""The arm: its servos by two protocols, where it is, how it gets somewhere, and what it must not touch."""
