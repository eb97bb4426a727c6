"""Code generation: a controller as C99 for a flight computer and as an FMU, and a vehicle as an FMU."""
