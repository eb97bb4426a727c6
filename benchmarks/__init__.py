"""What a flight costs: ``python -m benchmarks``."""
