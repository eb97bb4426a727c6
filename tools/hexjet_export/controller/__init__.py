"""A controller as C99 for a flight computer and as FMUs, with the flight that tests it."""
