"""A live feed of the flight to Foxglove, by a thread that reads the exchange so many times a second."""

from __future__ import annotations

import threading

from cosim.base.errors import InputError
from cosim.groundstation.exchange import Exchange
from cosim.results.export.foxglove_live import LiveExport
from cosim.results.export.output import LogLine

RATE_1_S = 25  # chosen by us: a picture every 40 ms, as the exported arrows; every step is in the run's log
# Seconds between two drawings of what does not move; a viewer that connects later waits at most this long for it.
REDRAW_S = 1.0
PORT = 8766  # next to the port of the page


def parse_address(text: str, public: bool) -> tuple[str, int]:
    """Return host and port of ``[HOST:]PORT``.  Raises InputError, also for the network without ``public``."""
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > 65535:
        raise InputError(f"--foxglove {text}: must be [HOST:]PORT, with a port from 0 to 65535")
    host = host or ("0.0.0.0" if public else "127.0.0.1")
    if host not in ("127.0.0.1", "localhost") and not public:
        raise InputError(f"--foxglove {text}: listens to the network, which needs --public")
    return host, int(port)


class FoxgloveFeed:
    """Thread that sends the exchange's snapshots to Foxglove, from :meth:`start` to :meth:`stop`."""

    def __init__(self, exchange: Exchange, host: str, port: int) -> None:
        self._exchange = exchange
        self._export = LiveExport(host, port)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)
        self.url = self._export.url

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread and close the server; may be called twice."""
        self._stopped.set()
        if self._thread.is_alive():
            self._thread.join()
        self._export.close()

    def _run(self) -> None:
        flight, step, last_line, look_count = 0, -1, 0, 0
        while not self._stopped.wait(1.0 / RATE_1_S):
            snapshot = self._exchange.snapshot
            if snapshot is None or snapshot.sample is None:
                continue
            scenario = snapshot.info.scenario
            if snapshot.info.number != flight:
                flight, step, look_count = snapshot.info.number, -1, 0
                self._export.begin(scenario, snapshot.info.columns)
            if look_count % round(REDRAW_S * RATE_1_S) == 0:
                self._export.draw(snapshot.sample.time)
            look_count += 1
            lines = [message for message in self._exchange.messages if message.number > last_line]
            last_line = lines[-1].number if lines else last_line
            self._export.say(
                LogLine(line.k, line.k * scenario.step_s, int(line.severity), "autopilot", line.text) for line in lines
            )
            if snapshot.sample.k != step:
                step = snapshot.sample.k
                self._export.tell(snapshot.sample)
