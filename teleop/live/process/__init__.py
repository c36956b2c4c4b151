"""The process of an end: timers, signals, scheduling, suspension, and its output."""
