"""Analyses of a scene: stability, passivity, Z-width and numerical precision."""
