"""The vehicle as a ground station sees it: links, telemetry, commands.  The only importer of pymavlink.

``link`` owns one background thread with every socket; ``vehicle`` is what runs in it; ``exchange`` is what the
stepping thread touches, and never waits for.
"""
