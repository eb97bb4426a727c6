"""FlightGear as a view of the flight: its native FDM packets over UDP, the same that JSBSim sends to it.

The packet is ``FGNetFDM``, version 24, of FlightGear's ``src/Network/net_fdm.hxx``: 408 bytes in network byte order,
angles in rad, speeds in ft/s, height in m.  FlightGear draws what it is told and flies nothing itself::

    fgfs --fdm=null --native-fdm=socket,in,60,,5550,udp
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Sequence
from contextlib import suppress
from math import asin, atan2, cos, hypot, isfinite, pi, radians, sin, sqrt, tan

from cosim import InputError
from cosim.base.frames import conjugate, rotate
from cosim.base.geodesy import Geodesy
from cosim.base.signals import Sample
from cosim.spec.scenario import Environment

VERSION, ENGINES, TANKS, WHEELS, CONTROLS = 24, 4, 4, 3, 10  # version of FGNetFDM, and array sizes
FORMAT = (  # FGNetFDM, version 24
    ">II3d"  # longitude, latitude, height
    # Height above ground, attitude, flow angles; rates; air speed, climb; velocities; specific force; stall, slip.
    "6f3f2f3f3f3f2f"
    f"I{ENGINES}I{9 * ENGINES}f"  # engines: state, nine numbers of each
    f"I{TANKS}f"
    f"I{WHEELS}I{3 * WHEELS}f"
    f"Iif{CONTROLS}f"  # time, warp, visibility, controls
)
# As often as FlightGear draws.
PACKETS_PER_S = 60.0
VISIBILITY_M = 25_000.0  # chosen by us: clear air
RUNNING, OFF = 2, 0  # FlightGear's values of eng_state


class FlightGear:
    """Observer that sends the vehicle's state to FlightGear by UDP, whether or not it runs."""

    def __init__(self, address: str, environment: Environment) -> None:
        self._to = parse_address(address)
        self._map = Geodesy(environment.latitude_deg, environment.longitude_deg, environment.ground_m)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._sent = 0

    def observe(self, sample: Sample) -> None:
        """Send a packet if one is due at this step."""
        if sample.time * PACKETS_PER_S + 1e-9 < self._sent:
            return
        self._sent += 1
        with suppress(OSError):  # FlightGear does not run there
            self._socket.sendto(pack_state(sample, self._map), self._to)

    def close(self) -> None:
        self._socket.close()


def parse_address(address: str) -> tuple[str, int]:
    """Return address and port of ``[HOST:]PORT``; without a host, of this machine.  Raises InputError."""
    host, _, port = address.rpartition(":")
    if not port.isdigit() or not 1 <= int(port) <= 65535:
        raise InputError(f"flightgear {address}: must be PORT or HOST:PORT, such as 5550")
    try:
        addresses = socket.getaddrinfo(host or "127.0.0.1", int(port), socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise InputError(f"flightgear {address}: {host}: {error.strerror or error}") from error
    name, number = addresses[0][4][:2]
    return str(name), int(number)


def pack_state(sample: Sample, where: Geodesy) -> bytes:
    """Return the state of one step as the packet that FlightGear reads.

    The speed of the instruments is the true air speed; fuel, gear and controls are left at zero.
    """
    state = sample.state
    latitude, longitude, height = where.to_geodetic(state.position[0], state.position[1], state.altitude)
    roll, pitch, yaw = state.euler
    p, q, r = state.rate
    turn = q * sin(roll) + r * cos(roll)
    feet, knot = 1.0 / 0.3048, 1852.0 / 3600.0  # feet per metre; m/s per knot
    level = max(-1.5, min(1.5, pitch))  # keeps the Euler rates finite
    (north, east, down), wind, to_body = state.velocity, state.wind, conjugate(state.attitude)
    air = rotate(to_body, (north - wind[0], east - wind[1], down - wind[2]))
    u, v, w = rotate(to_body, state.velocity)
    speed = sqrt(sum(component * component for component in air))
    slip = asin(max(-1.0, min(1.0, air[1] / speed))) if speed > 0.0 else 0.0
    flow = atan2(air[2], air[0]) if hypot(air[0], air[2]) > 0.0 else 0.0
    thrust, turning, heat = (_pad_to_four_engines(each) for each in (sample.engines.thrust, sample.engines.spool_speed,
                                                      sample.engines.exhaust_temperature))  # fmt: skip
    nothing = [0.0] * ENGINES
    return struct.pack(
        FORMAT,
        *(VERSION, 0, radians(longitude), radians(latitude), height),
        *(state.altitude, roll, pitch, yaw, flow, slip),
        *(p + turn * tan(level), q * cos(roll) - r * sin(roll), turn / cos(level)),
        *(speed / knot, -down * feet),
        *(length * feet for length in (north, east, down, u, v, w)),
        *(component * feet for component in state.specific_force),
        *(0.0, slip * 180.0 / pi),
        min(len(sample.engines.thrust), ENGINES),
        *(RUNNING if force > 0.0 else OFF for force in thrust),
        *(rate * 30.0 / pi for rate in turning),  # rpm
        *nothing,  # fuel flow: not reported
        *nothing,  # fuel pressure: not reported
        *(max(kelvin * 1.8 - 459.67, 0.0) for kelvin in heat),  # degrees Fahrenheit
        *(nothing * 5),
        *(0, *([0.0] * TANKS)),
        *(WHEELS, *([int(state.on_ground)] * WHEELS), *([0.0] * (3 * WHEELS))),
        *(0, 0, VISIBILITY_M, *([0.0] * CONTROLS)),
    )


def _pad_to_four_engines(values: Sequence[float]) -> list[float]:
    """Return the values of the first four engines, 0 if absent or not reported."""
    finite = [value if isfinite(value) else 0.0 for value in values[:ENGINES]]
    return finite + [0.0] * (ENGINES - len(finite))
