"""The connections of a session: MAVLink links with all their services and the local page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from cosim.base.errors import InputError
from cosim.control.autopilot.modes import Severity
from cosim.groundstation.exchange import Exchange, FlightInfo, Port, Restart, Shutdown
from cosim.groundstation.mavlink.services.ftp import File, FileService, MemoryFile
from cosim.groundstation.mavlink.services.logs import LOG_FOLDER, LogService, LogStore, find_finished_runs
from cosim.groundstation.mavlink.services.metadata import Metadata
from cosim.groundstation.mavlink.services.missions import MissionService
from cosim.groundstation.mavlink.services.params import ParameterService
from cosim.groundstation.mavlink.telemetry_state import Personality, VehicleConstants
from cosim.groundstation.mavlink.vehicle import MavlinkVehicle
from cosim.groundstation.mavlink.wire.link import Link
from cosim.groundstation.mavlink.wire.signing import Signing, read_key
from cosim.groundstation.mavlink.wire.tlog import TelemetryLog
from cosim.groundstation.mavlink.wire.transports import endpoint
from cosim.groundstation.read_only import ReadOnlyObserver
from cosim.results.run import REQUESTS, TELEMETRY
from cosim.results.summary import versions


class Links:
    """MAVLink links to ``urls`` (by default the two that ground stations listen to), and the local page.

    They are silent before the first flight begins.  ``public``: servers may listen to the network.
    ``sign_key``: a file with the key.  ``web``: the page's port, None for no page.  ``system``: the vehicle's MAVLink
    id, by which stations tell several apart.  Raises InputError for
    a URL, key, port or id that cannot be used.
    """

    def __init__(
        self,
        urls: Sequence[str] = (),
        public: bool = False,
        sign_key: Path | None = None,
        personality: Personality = "px4",
        web: int | None = None,
        system: int = 1,
    ) -> None:
        if system not in endpoint.SYSTEMS:
            most = endpoint.SYSTEMS[-1]
            raise InputError(f"system {system}: must be from 1 to {most}; ground stations have the ids above")
        self.exchange = Exchange()
        self.system = system
        self.endpoints = [endpoint.parse_endpoint(url, public) for url in urls or endpoint.default_urls(system)]
        self._personality = personality
        signing = None if sign_key is None else Signing(read_key(sign_key))
        self._exchange_port = Port(self.exchange, "mavlink")
        self.link = Link(self.endpoints, system, signing=signing)
        self.link.on_event = lambda text: self.exchange.say(Severity.WARNING, text)
        self._page = None
        self._vehicle: MavlinkVehicle | None = None
        self._parameters: ParameterService | None = None
        self._log_store: LogStore | None = None
        self._folder: Path | None = None
        try:
            if web is not None:
                from cosim.groundstation.web.server import WebServer

                self._page = WebServer(self.exchange, web)
                self._page.start()
        except BaseException:
            self.close()
            raise

    @property
    def urls(self) -> list[str]:
        return [
            endpoint._replace(port=port or endpoint.port).url
            for endpoint, port in zip(self.endpoints, self.link.ports, strict=True)
        ]

    @property
    def page_url(self) -> str | None:
        return self._page.url if self._page is not None else None

    @property
    def stations_heard(self) -> int:
        """Number of ground stations from which a frame was received."""
        return sum(peer.last_heard >= 0.0 for peer in self.link.peers)

    @property
    def frame_counts(self) -> dict[str, Any]:
        """Counts of accepted frames, of refused frames and requests by reason, and of internal failures."""
        link = self.link
        return {
            "taken": link.taken,
            "refused": dict(link.refused),
            "turned_away": self.exchange.turned_away,
            "failures": dict(link.failures),
        }

    def begin(self, info: FlightInfo) -> None:
        """Begin a flight: open its telemetry log, and start the link on the first flight."""
        self._folder = info.folder
        if info.folder is not None and info.folder.is_dir():
            self._replace_log(TelemetryLog(info.folder / TELEMETRY, self.system))
        if self._vehicle is None:
            self._start_vehicle(info)
        elif self._parameters is not None:
            self._parameters.replace(info.parameters)

    def end(self) -> None:
        """End a flight: close its telemetry log, and offer its run as a log for download."""
        self._replace_log(None)
        if self._log_store is not None:
            self._log_store.mark_outdated()

    def make_read_only_observer(self) -> ReadOnlyObserver:
        """Return an observer that shows a flight on these links and refuses every request."""
        return ReadOnlyObserver(self.exchange, self.begin)

    def close(self) -> None:
        """Close page, links and log store; may be called twice."""
        if self._page is not None:
            self._page.stop()
            self._page = None
        self._exchange_port.unsubscribe()
        self.link.close()
        if self._log_store is not None:
            self._log_store.close()
            self._log_store = None

    def __enter__(self) -> Links:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _start_vehicle(self, info: FlightInfo) -> None:
        constants = make_vehicle_constants(info, self._personality, self.system)
        vehicle = self._vehicle = MavlinkVehicle(
            constants, self._exchange_port, self.link, shutdown_requests=(Restart(), Shutdown())
        )
        page = self._page
        if page is not None:
            vehicle.page_count = lambda: page.clients
        self._parameters = ParameterService(info.parameters, self._exchange_port.ask, self._personality)
        metadata = Metadata(info.parameters, constants.name, constants.version)
        log_store = self._log_store = LogStore(self._find_session_runs)
        files: dict[str, File] = {path: MemoryFile(data) for path, data in metadata.files.items()}
        exchange = self.exchange
        missions = MissionService(
            lambda: exchange.snapshot.mission if exchange.snapshot else (),
            lambda: exchange.snapshot.status if exchange.snapshot else None,
            self._exchange_port.ask,
            info.geodesy,
        )
        vehicle.services += [
            self._parameters,
            missions,
            FileService(partial(find_files, files, log_store)),
            LogService(log_store),
        ]
        vehicle.on_request |= metadata.on_request
        self.link.start(vehicle)

    def _replace_log(self, log: TelemetryLog | None) -> None:
        before, self.link.log = self.link.log, log
        if before is not None:
            before.close()

    def _find_session_runs(self) -> list[Path]:
        """Return the folders of finished session runs beside this flight's, the oldest first."""
        if self._folder is None:
            return []
        return [run for run in find_finished_runs(self._folder.parent) if (run / REQUESTS).exists()]


def find_files(metadata: Mapping[str, File], log_store: LogStore, path: str) -> Mapping[str, File]:
    """Return the files that a path may name: metadata, and in the root and in ``log`` the converted logs."""
    is_of_logs = path == "" or f"{path}/".startswith(LOG_FOLDER)
    return {**metadata, **log_store.files()} if is_of_logs else metadata


def make_vehicle_constants(info: FlightInfo, personality: Personality, system: int = 1) -> VehicleConstants:
    vehicle, sensors = info.vehicle, info.vehicle.sensors
    return VehicleConstants(
        info.geodesy,
        len(vehicle.jets),
        vehicle.name,
        versions().get("hexjet-cosim", "0.0.0"),  # a checkout has none
        personality,
        system,
        tilt_range=vehicle.servo.range_rad if vehicle.servo else float("nan"),
        servos=vehicle.actuators,
        ranges=() if vehicle.servo else vehicle.ranges,
        full_thrust=tuple(spec.curve.thrust[-1] for spec in info.stations),
        fuel_capacity=vehicle.fuel.mass_kg if vehicle.fuel else float("nan"),
        position_noise=sensors.gnss.position_noise_m,
        velocity_noise=sensors.gnss.velocity_noise_m_s,
        height_noise=sensors.barometer.noise_m,
    )
