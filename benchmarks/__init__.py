"""What a flight costs, with one JSBSim run as the unit: steps, starts, memory, how they grow, and what others take.

``python -m benchmarks``, or ``hexjet benchmark`` where this is installed from a checkout.  Times belong to the machine
they were taken on, ratios travel better.  What the project asks of itself is reported beside what was found, and
nothing fails.
"""

import cosim  # noqa: F401 - before numpy, whose kernels it chooses
