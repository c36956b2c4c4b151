"""Comparison of laws: laws x links x environments x seeds, in one table and one figure a question."""
