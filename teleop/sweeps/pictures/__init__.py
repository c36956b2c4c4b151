"""Pictures and reports of sweeps."""
