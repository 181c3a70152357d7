"""Comparison of capture plans in simulation: how many pictures and camera heights a scan needs."""
