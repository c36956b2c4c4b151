"""Virtual time: the tick, the loop made of it, and the result of a run."""
