"""What an exporter of logs is made of: a run's columns with their meanings, its events and its autopilot's record.

``FORMAT = "package.module:function"`` in the entry points ``hexjet.exporters`` adds ``hexjet export DIR --to FORMAT``;
the function gets a run that has a folder, and the path of a new file to write.

Examples
--------
>>> def export_plain(run, path):
...     names = [column.name for column in describe_columns(run) if column.unit == "rad"]
...     with open(path, "w") as file:
...         for block in run.log.blocks(tuple(names)):
...             file.writelines(f"{row}\\n" for row in zip(*block.values()))
"""

from cosim.base.protocols import Column
from cosim.results.autopilot.autopilot_record import read_pilot_record
from cosim.results.events import list_events
from cosim.results.export import describe_columns, run_properties
from cosim.results.log.columns import HEXJET, RATES, LoggedVehicle, custom_columns, jets_in, logged_vehicle_of
from cosim.results.run import SCENARIO, SUMMARY
from cosim.results.summary import Summary

__all__ = [
    "HEXJET",
    "RATES",
    "SCENARIO",
    "SUMMARY",
    "Column",
    "LoggedVehicle",
    "Summary",
    "custom_columns",
    "describe_columns",
    "jets_in",
    "list_events",
    "logged_vehicle_of",
    "read_pilot_record",
    "run_properties",
]
