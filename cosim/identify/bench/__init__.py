"""From an engine's bench log to a model with bounds, and to an engine that flies."""

from cosim.identify.bench.identify import BenchIdentification, Choices, identify_bench
from cosim.identify.bench.record import BenchRecord, Columns, read_records

__all__ = ["BenchIdentification", "BenchRecord", "Choices", "Columns", "identify_bench", "read_records"]
