"""What a flight costs: a step with one JSBSim run as the unit, the way to the first step, the memory of a long flight.

Reports and judges nothing: times belong to the machine they were taken on, ratios travel better.
"""

from cosim.bench.suite import Plan, Result, measure

__all__ = ["Plan", "Result", "measure"]
