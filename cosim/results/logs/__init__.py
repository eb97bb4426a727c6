"""Flight logs, whoever wrote them, in one form: named channels with their times, and what is to be said of the file."""

from cosim.results.logs.flight_log import Channel, FlightLog, Wanted
from cosim.results.logs.read import KINDS, read_flight_log, wanted

__all__ = ["KINDS", "Channel", "FlightLog", "Wanted", "read_flight_log", "wanted"]
