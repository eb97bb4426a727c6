"""The vehicle as a ground station sees it: links, telemetry, commands.

``wire.link`` owns one background thread with every socket; ``vehicle`` is what runs in it;
:mod:`cosim.groundstation.exchange` is what the stepping thread touches, and never waits for.
"""
