"""Sweeps: one scene over many knobs and seeds."""
