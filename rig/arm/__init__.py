"""Drivers of the robot arm with two servo protocols, kinematics, path planning and collision checks."""
