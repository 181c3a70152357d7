"""Numbers of robust statistics."""

MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation: one over its 75 % quantile,
0.6745."""
