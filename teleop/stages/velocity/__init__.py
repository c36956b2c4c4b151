"""Velocity estimators of a haptic device, one file each: equations, source and error."""
