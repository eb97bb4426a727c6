"""Commands of many flights."""
