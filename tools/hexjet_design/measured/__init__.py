"""Margins of any controller, measured in flight."""
