"""The commands."""

from __future__ import annotations

# Options of the part of a log that is read, and what stands for their values.
LOG_OPTIONS = {"time_column": "--time", "begin": "--begin --from", "end": "--end --to"}
LOG_METAVARS = {"time_column": "NAME", "time_unit": "UNIT", "begin": "S", "end": "S"}
