"""What left the program: since which version, and what to use instead.

``docs/versions.md`` has the same table, and a test compares the two.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple


class Removal(NamedTuple):
    """A removed feature: its name in words, the first version without it, and its replacement."""

    what: str
    since: str
    instead: str


_OUTER_RATE_LOOP: Final = Removal(  # shared by several removed names
    "a rate loop from outside", "0.3.0", "hexjet export controller --for, which puts it inside the autopilot"
)
_ENGINE_OUT_TABLE: Final = Removal(  # shared by several removed names
    "the table of three vehicles with one engine out", "0.3.0", "hexjet faults --kind flame-out for a vehicle"
)
_PAGE_SCRIPTS: Final = Removal("writing this project's own pages", "0.3.0", "the scripts in docs/ of a checkout")
_COST_BENCHMARK: Final = Removal("the cost of memory and of a campaign", "0.3.0", "benchmarks of version 0.2.0")


def _renamed(now: str) -> Removal:
    return Removal("an old name", "0.3.0", now)


# Removals by what users write: an option, a command, a key, or the beginning of a value.
REMOVED: Final[Mapping[str, Removal]] = {
    "hexjet bench": _renamed("hexjet benchmark"),
    "hexjet failsafes": _renamed("hexjet faults --autopilot, for one aircraft"),
    "hexjet fmu": _renamed("hexjet engine check, map or build"),
    "hexjet identify bench": _renamed("hexjet engine from-bench"),
    "hexjet identify engine": _renamed("hexjet engine identify"),
    "hexjet list": _renamed("hexjet show"),
    "hexjet rare": _renamed("hexjet search --rare"),
    "hexjet report": _renamed("hexjet show --page"),
    "hexjet validate": _renamed("hexjet replay LOG --model MODEL"),
    "hexjet fmu compile": Removal("compiling the sources of an FMU", "0.3.0", "python -m fmpy compile FILE.fmu"),
    "hexjet fmu survey": Removal(
        "the table of many engines", "0.3.0", "hexjet engine check and hexjet design for each"
    ),
    "hexjet faults --engine-out": _ENGINE_OUT_TABLE,
    "hexjet faults --designs": _ENGINE_OUT_TABLE,
    "hexjet faults --docs": _PAGE_SCRIPTS,
    "hexjet faults --page": _PAGE_SCRIPTS,
    "hexjet paper --page": _PAGE_SCRIPTS,
    "hexjet engine build --windows": Removal("building for Windows", "0.3.0", "a wheel made on Windows"),
    "hexjet gcs --foxglove": Removal(
        "the live feed for Foxglove", "0.3.0", "hexjet export RUN --to mcap, which Foxglove opens"
    ),
    "hexjet sitl betaflight --rates": _OUTER_RATE_LOOP,
    "hexjet sitl px4 --rates": _OUTER_RATE_LOOP,
    "hexjet benchmark --campaign": _COST_BENCHMARK,
    "hexjet benchmark --memory-minutes": _COST_BENCHMARK,
    "hexjet open --port": Removal("the server of hexjet open", "0.3.0", "the page that hexjet open writes"),
    ".ssp": Removal("a system of FMUs (SSP) as an engine", "0.3.0", "one FMU; OMSimulator and FMPy run systems"),
    "input clock": Removal("input clocks of FMI 3.0", "0.3.0", "an FMU that samples by itself, once a step"),
    "several engines": Removal("several engines in one FMU", "0.3.0", "one FMU for each engine"),
    "sequence": Removal(
        "the start of an engine in stages", "0.3.0", "[inputs], held from the beginning, and [start] warm_up_s"
    ),
    "engine_start": Removal(
        "the start of engines in flight", "0.3.0", "[start] warm_up_s of the mapping file, before the flight"
    ),
    "parameter_set": Removal("a parameter set in a file of its own (SSV)", "0.3.0", "[parameters] of the mapping file"),
    "serial:": Removal("serial links", "0.3.0", "socat, which joins a serial device to a UDP port"),
}


def describe_removed(name: str) -> str | None:
    """Return a sentence on the removed feature of this name, or None.

    >>> describe_removed("serial:")
    'serial links left in version 0.3.0; use socat, which joins a serial device to a UDP port'
    """
    removal = REMOVED.get(name)
    return None if removal is None else f"{removal.what} left in version {removal.since}; use {removal.instead}"


# Error for a file that a version before 0.2.0 wrote.
WRITTEN_BEFORE: Final = "written before version 0.2.0; open it with 0.2.0"


def is_written_before(version: str | None) -> bool:
    """Return whether a recorded version is one before 0.2.0.

    >>> is_written_before("0.1.0"), is_written_before("0.2.0"), is_written_before(None)
    (True, False, False)
    """
    return version is not None and version.startswith(("0.0.", "0.1."))
