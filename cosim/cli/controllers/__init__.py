"""Commands that make a controller and judge it."""
