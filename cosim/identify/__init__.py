"""From data to a model: readers of flight logs, identification by a sweep, identification from a log."""
