"""Figures and reports of sweeps."""
