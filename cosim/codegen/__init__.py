"""A controller out again: as C99 for a flight computer, and as an FMU."""
