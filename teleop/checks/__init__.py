"""Checks of a law: its interface, its claims, and its closed loops under random conditions."""
