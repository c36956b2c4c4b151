"""Short scripts, one for each thing that a user adds: run one as it stands, copy it, change it."""
