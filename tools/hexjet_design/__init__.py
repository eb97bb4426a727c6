"""Predictor and gains designed for an engine, margins measured in flight, and the limit of what any design reaches."""
