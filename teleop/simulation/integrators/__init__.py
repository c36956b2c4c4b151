"""Fixed-step methods that can move the bodies of a scene in place of the exact steps."""
