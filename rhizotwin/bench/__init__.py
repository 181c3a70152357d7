"""Benchmarks for reconstruction methods: simulated scans whose ground truth is known exactly."""
