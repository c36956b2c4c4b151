"""Benchmarks to be run by hand: `python -m teleop.bench`. Every claim is a ratio measured in one run."""
