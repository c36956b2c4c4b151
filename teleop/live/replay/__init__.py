"""A live run that is run again: each end's law over what the end read and heard."""
