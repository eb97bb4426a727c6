"""Engines and controllers compiled for this machine."""
