"""Comparison of laws: laws x links x environments x seeds, told in one table and one figure a question."""
