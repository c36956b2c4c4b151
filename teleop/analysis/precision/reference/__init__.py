"""The reference solution, its own error, and how far a method deviates from it."""
