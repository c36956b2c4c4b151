"""The reference solution, and how far a method deviates from it."""
