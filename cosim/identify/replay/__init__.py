"""A recorded flight flown again by the model of a vehicle, and what that says of the model."""

from cosim.identify.replay.recorded import (
    RecordedFlight,
    ThrottleChannels,
    has_commands,
    hash_log,
    is_simulated,
    record_flight,
)
from cosim.identify.replay.replay import Choices, Replay, replay
