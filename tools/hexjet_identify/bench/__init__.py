"""From an engine's bench log to a model with bounds, and to an engine that flies."""

from hexjet_identify.bench.identification import Identification
from hexjet_identify.bench.identify import Choices, identify_bench
from hexjet_identify.bench.record import BenchRecord, Columns, read_records

__all__ = ["BenchRecord", "Choices", "Columns", "Identification", "identify_bench", "read_records"]
