"""Autopilots of others, as programs of their own, in lockstep with a flight: see docs/autopilots.md."""
