"""Files and folders: claimed, written whole or not at all, and read with bounds where their origin is unknown."""
