"""Advice: which law, with which gains, over a link that was recorded or described, against a wall."""
