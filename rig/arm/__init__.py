"""Robot arm: two servo protocols, kinematics, path planning and collision checks."""
