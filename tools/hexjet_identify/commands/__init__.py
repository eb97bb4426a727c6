"""The commands."""

from __future__ import annotations

# Command-line options by argument that select the part of a log, and the placeholders of their values in the help.
LOG_OPTIONS = {"time_column": "--time", "begin": "--begin --from", "end": "--end --to"}
LOG_METAVARS = {"time_column": "NAME", "time_unit": "UNIT", "begin": "S", "end": "S"}
