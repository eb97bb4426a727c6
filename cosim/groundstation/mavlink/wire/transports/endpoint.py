"""URLs of links: ``udpout:127.0.0.1:14550``, ``udpin:``, ``tcp:`` and ``tcpin:``."""

from __future__ import annotations

import socket
from ipaddress import ip_address
from typing import NamedTuple

from cosim.base.errors import InputError
from cosim.base.removed import describe_removed

SYSTEMS = range(1, 251)  # ids of vehicles, below those of stations
NETWORK = ("udpout", "udpin", "tcp", "tcpin")  # kinds of endpoints
LOOPBACK = "127.0.0.1"
_URL_FORMS = "udpout:HOST:PORT, udpin:[HOST:]PORT, tcp:HOST:PORT or tcpin:[HOST:]PORT"  # allowed URLs


def default_urls(system: int = 1, single: int = 10) -> tuple[str, str]:
    """Return the URLs of a vehicle's default links by its system id.

    QGroundControl listens on 14550 to all vehicles; programs with MAVSDK to one each, 14540 the first.
    """
    return "udpout:127.0.0.1:14550", f"udpout:127.0.0.1:{14540 + min(system, single) - 1}"


class Endpoint(NamedTuple):
    """Parsed URL of one link."""

    kind: str  # one of NETWORK
    host: str  # IP address
    port: int
    family: int = socket.AF_INET

    @property
    def url(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.kind}:{host}:{self.port}"


def parse_endpoint(url: str, public: bool = False) -> Endpoint:
    """Parse the URL of a link.

    ``public``: a server may listen to the network and not only to this machine.  Raises InputError.
    """
    kind, colon, rest = url.strip().partition(":")
    rest = rest.removeprefix("//")
    if kind == "serial":
        raise InputError(f"link {url!r}: {describe_removed('serial:')}")
    if not colon or not rest or kind not in NETWORK:
        raise InputError(f"link {url!r}: must be {_URL_FORMS}")
    host, _, port = rest.rpartition(":")
    if not (port.isascii() and port.isdigit() and len(port) < 6 and 0 <= int(port) < 65536):
        raise InputError(f"link {url!r}: the port {port!r} must be a number from 0 to 65535")
    serves = kind in ("udpin", "tcpin")
    if not serves and int(port) == 0:
        raise InputError(f"link {url!r}: port 0 is for udpin and tcpin only")
    host = host.removeprefix("[").removesuffix("]")
    if not host:
        if not serves:
            raise InputError(f"link {url!r}: the host is missing; must be {_URL_FORMS}")
        host = LOOPBACK
    address, family = _resolve_host(host, url)
    if serves and not public and not ip_address(address.partition("%")[0]).is_loopback:
        raise InputError(
            f"link {url!r}: {host} is open to the network, and whoever reaches it can fly the vehicle; "
            "allow it with public, or use 127.0.0.1"
        )
    return Endpoint(kind, address, int(port), family)


def _resolve_host(host: str, url: str) -> tuple[str, int]:
    try:
        infos = socket.getaddrinfo(host, None, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise InputError(f"link {url!r}: the host {host!r} is not known") from error
    family, *_, address = next((info for info in infos if info[0] == socket.AF_INET), infos[0])
    return str(address[0]), int(family)
