"""Compiled kernels: one loop a structure, run over many rows."""
