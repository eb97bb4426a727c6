"""A flight while it flies, for Foxglove: the channels and messages of an exported MCAP on a WebSocket of its own.

The only module that touches Foxglove's SDK, an extra.  Nothing can be asked of the vehicle here: the server offers no
capability beyond telling.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import Any

from cosim.base.errors import InputError
from cosim.base.protocols import Column
from cosim.base.signals import Sample
from cosim.results.export.output import LogLine
from cosim.results.log.columns import log_columns, logged_vehicle
from cosim.results.log.recorder import OneRow
from cosim.spec.scenario import Scenario

WAITING = 256  # messages that may wait for one viewer, chosen by us: those of a second; then the oldest goes


class LiveExport:
    """Serves one session at ``host`` and ``port`` (0: any that is free), from its making on.

    Raises InputError where the extra is not installed or the port cannot be opened.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            sdk: Any = import_module("foxglove")
            self._mcap: Any = import_module("cosim.results.export.mcap_file")
            self._scene: Any = import_module("cosim.results.export.scene")
        except ModuleNotFoundError as error:
            if (error.name or "").startswith("cosim"):
                raise
            raise InputError(
                f"--foxglove needs {error.name}, which is not installed: pip install 'hexjet-cosim[foxglove]'"
            ) from None
        self._sdk, self._context = sdk, sdk.Context()
        try:
            self._server = sdk.start_server(
                name="hexjet", host=host, port=port, context=self._context, message_backlog_size=WAITING
            )
        except Exception as error:  # the SDK's own, which has no other base
            raise InputError(f"--foxglove {host}:{port}: the port cannot be opened: {error}") from None
        self.url = f"ws://{host}:{self._server.port}"
        self._schemas: list[Any] = []
        self._channels: list[Any] = []
        self._row: OneRow | None = None

    # --- as the writer of an MCAP -----------------------------------------------------------------------------

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Keep a schema; its number."""
        self._schemas.append(self._sdk.Schema(name=name, encoding=encoding, data=data))
        return len(self._schemas) - 1

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str] | None = None
    ) -> int:
        """Open a channel; its number."""
        schema = self._schemas[schema_id]
        channel = self._sdk.Channel(
            topic, message_encoding=message_encoding, schema=schema, context=self._context, metadata=metadata or {}
        )
        self._channels.append(channel)
        return len(self._channels) - 1

    # --- a flight ---------------------------------------------------------------------------------------------

    def begin(self, scenario: Scenario, custom: Sequence[Column] = ()) -> None:
        """Start a flight whose blocks show ``custom``: its channels take the place of the last one's."""
        for channel in self._channels:
            channel.close()
        self._schemas, self._channels = [], []
        self._server.clear_session()
        self._vehicle = scenario.resolved_vehicle()[0]
        columns = log_columns(logged_vehicle(self._vehicle), custom)
        self._row = OneRow(columns)
        self._columns = self._mcap.register_channels(self, columns)
        self._drawn = self._scene.Scene(self, scenario.step_s, scenario)
        self._log = self._mcap.register_log_channel(self)
        self._still = next(number for number, channel in enumerate(self._channels) if channel.topic() == "/scene")

    def tell(self, sample: Sample) -> None:
        """Send the flight at one step to the clients; a channel without a client is not computed."""
        looked_at = [number for number, channel in enumerate(self._channels) if channel.has_sinks()]
        if self._row is None or not looked_at:
            return
        block = dict(zip(self._row.names, self._row(sample), strict=True))
        columns = [channel for channel in self._columns if channel.number in looked_at]
        messages = list(self._mcap.iterate_messages(columns, block, sample.k))
        if len(columns) < len(looked_at):
            messages += self._drawn.messages(block, sample.k, sample.k)
        for _, time, number, content in messages:
            self._channels[number].log(content, log_time=time)

    def draw(self, time: float) -> None:
        """Send the vehicle once more, for clients that came since; ``time`` [s] of the flight."""
        if self._row is not None and self._channels[self._still].has_sinks():
            stamp = round(1e9 * time)
            self._channels[self._still].log(
                self._scene.draw_vehicle(self._vehicle, stamp).SerializeToString(), log_time=stamp
            )

    def say(self, lines: Iterable[LogLine]) -> None:
        """Send the lines of text of the flight."""
        for line in lines:
            _, time, number, content = self._mcap.make_text_message(self._log, line)
            self._channels[number].log(content, log_time=time)

    def close(self) -> None:
        """Tell no more; may be called twice."""
        self._server.stop()
