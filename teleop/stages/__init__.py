"""Stages between a device and its law, and between a law and its motor."""
