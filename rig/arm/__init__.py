"""The arm: servo protocols, kinematics, positioning, and collision checks."""
