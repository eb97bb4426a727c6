"""Bytes: frames, transports, links, signing."""
