"""How exact the airframe is: ``python -m benchmarks.accuracy``."""
