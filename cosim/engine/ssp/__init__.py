"""A system of FMUs as one engine."""
