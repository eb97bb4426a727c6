"""Bytes in and out: UDP, TCP, serial lines."""
