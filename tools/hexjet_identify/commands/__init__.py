"""The commands."""

from __future__ import annotations

# Command-line options that select the columns and times of a log, and their placeholders in the help.
LOG_OPTIONS = {"time_column": "--time", "begin": "--begin --from", "end": "--end --to"}
LOG_METAVARS = {"time_column": "NAME", "time_unit": "UNIT", "begin": "S", "end": "S"}
