"""What a flight leaves: columns, the log, metrics, the run folder, exports."""
