"""Models from recordings: readers of flight logs, identification from a bench or a flight, validation, replay."""

import cosim  # noqa: F401 - before numpy, whose kernels it chooses
