"""Many flights at once on arrays: ``fly_batch`` flies scenarios, ``step`` is one control step of all of them."""

from hexjet_batch.fly import BatchFlight, fly_batch
from hexjet_batch.make import REFUSED, read_flight
from hexjet_batch.numbers import Numbers, stack
from hexjet_batch.stages.step import Inputs, Outputs, State, start, step

__all__ = ["REFUSED", "BatchFlight", "Inputs", "Numbers", "Outputs", "State", "fly_batch", "read_flight", "stack",
           "start", "step"]  # fmt: skip
