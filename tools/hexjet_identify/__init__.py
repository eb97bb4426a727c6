"""Models from recordings: readers of flight logs, identification from a bench or a flight, validation, replay."""
