"""The accuracy ladder and the speed of rhizotwin, with committed baselines and a gate: ``python -m benchmarks --help``."""
