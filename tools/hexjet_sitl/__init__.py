"""Autopilots of others that fly the vehicle in lockstep: PX4, ArduPilot, Betaflight."""
