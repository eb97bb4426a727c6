"""Flight logs, whoever wrote them, in one form: named channels with their times, and what is to be said of the file."""

from cosim.results.logs.flight_log import Channel, FlightLog, Wanted
from cosim.results.logs.read import KINDS, is_flight_log, read_flight_log, wanted

__all__ = ["KINDS", "Channel", "FlightLog", "Wanted", "is_flight_log", "read_flight_log", "wanted"]
