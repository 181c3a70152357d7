"""A result against the truth of a simulated dataset; the reconstruction itself never opens it."""
