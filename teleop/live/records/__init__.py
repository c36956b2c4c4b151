"""The records of live ends: written row by row, summed up, and merged into one result."""
