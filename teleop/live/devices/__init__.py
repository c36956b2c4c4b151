"""Devices with their guards: checked readings, and a watchdog process."""
