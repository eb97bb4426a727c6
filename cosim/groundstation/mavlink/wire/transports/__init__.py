"""Bytes in and out: UDP and TCP."""
