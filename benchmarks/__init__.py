"""Accuracy ladder and speed of rhizotwin, with committed baselines and a gate.

See ``python -m benchmarks --help``.
"""
