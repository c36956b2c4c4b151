"""Bodies and what they touch: exact solutions and integrated ones."""
