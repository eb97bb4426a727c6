"""What an exporter of logs is made of: a run's columns with their meanings, its events and its autopilot's record.

``FORMAT = "package.module:function"`` in the entry points ``hexjet.exporters`` adds ``hexjet export DIR --to FORMAT``;
the function gets a run that has a folder, and the path of a new file to write.
"""

from cosim.base.outcomes import Verdict
from cosim.base.protocols import Column
from cosim.results.autopilot.autopilot_record import read_pilot_record
from cosim.results.events import list_events
from cosim.results.export import describe_columns, run_properties
from cosim.results.log.columns import HEXJET, RATES, LoggedVehicle, custom_columns, jets_in, logged_vehicle_of
