"""Logs of runs in formats of others: ULog, MCAP and MAT, and FlightGear as a view of a flight."""
