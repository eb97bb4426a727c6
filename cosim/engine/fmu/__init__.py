"""One FMU: its archive, its description, its ports and units, and an instance of it."""
