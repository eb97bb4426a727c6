"""A recorded flight flown again by the model of a vehicle, and what that says of the model."""

from hexjet_identify.replay.recorded import RecordedFlight, ThrottleChannels, hash_log, is_simulated, record_flight
from hexjet_identify.replay.replay import Choices, Replay, replay
