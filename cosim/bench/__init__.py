"""What a flight costs, with one JSBSim run as the unit: steps, starts, memory, how they grow, and what others take.

Times belong to the machine they were taken on, ratios travel better.  What the project asks of itself is reported
beside what was found, and nothing fails.
"""

from cosim.bench.suite import (
    FULL,
    Plan,
    Result,
    make_plan,
    measure,
)

__all__ = ["FULL", "Plan", "Result", "make_plan", "measure"]
