"""Flight logs, whoever wrote them, in one form: named channels with their times, and what is to be said of the file."""

from hexjet_identify.logs.flight_log import Channel, FlightLog, LogSignals, unit_of
from hexjet_identify.logs.read import KINDS, is_flight_log, read_flight_log, signals_of
