"""TDMS, as LabVIEW writes it, read by npTDMS."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from hexjet_identify.logs.flight_log import Channel, FlightLog, numbers
from hexjet_identify.logs.table import SECONDS_PER_UNIT, TIME_NAMES, plain_name, time_unit, unit_in_name

# Properties in which a channel's unit may be.
UNIT_KEYS = ("unit_string", "NI_UnitDescription", "unit", "units")
STEP, OFFSET = "wf_increment", "wf_start_offset"  # s from row to row, and of the first


def read(path: Path) -> FlightLog:
    """Read a TDMS file: a channel by its name, by group and name where two are called alike.

    Its time [s] is that of its waveform (``wf_increment``), else of the channel of its group that is called so, as of
    tables.  Raises InputError without npTDMS, for a damaged file, and where no channel has a time.
    """
    if find_spec("nptdms") is None:
        raise InputError(f"{path}: TDMS needs npTDMS, which is not installed: pip install nptdms")
    from nptdms import TdmsFile

    try:
        file = TdmsFile.read(path)
    except (ValueError, KeyError, OSError, EOFError) as error:
        raise InputError(f"{path}: a TDMS file that cannot be read: {error}") from error
    names = [channel.name for group in file.groups() for channel in group.channels()]
    channels: dict[str, Channel] = {}
    left_out = []
    for group in file.groups():
        stamps = next((each for each in group.channels() if _is_time_channel(each)), None)
        for each in group.channels():
            name = each.name if names.count(each.name) == 1 else f"{group.name}/{each.name}"
            if each is stamps or not np.issubdtype(each.dtype, np.number) or not len(each):
                continue
            times = _read_times(each, stamps)
            if times is None:
                left_out.append(name)
                continue
            unit = next(
                (str(each.properties[key]) for key in UNIT_KEYS if each.properties.get(key)), unit_in_name(each.name)
            )
            channels[name] = Channel(times, numbers(each[:]), unit)
    if not channels:
        raise InputError(f"{path}: no channel has a time: neither {STEP} nor one of its group called {TIME_NAMES[1]}")
    remarks = (f"left out, having no time: {', '.join(left_out)}",) if left_out else ()
    return FlightLog(path, "TDMS", channels, remarks)


def _is_time_channel(channel: Any) -> bool:
    return plain_name(channel.name) in TIME_NAMES and not channel.properties.get(STEP)


def _read_times(channel: Any, stamps: Any | None) -> Array | None:
    """Return a channel's times [s], or None where neither a waveform nor a channel of as many rows has them."""
    if channel.properties.get(STEP):
        first = float(channel.properties.get(OFFSET, 0.0))
        return np.asarray(first + float(channel.properties[STEP]) * np.arange(len(channel)))
    if stamps is None or len(stamps) != len(channel):
        return None
    if np.issubdtype(stamps.dtype, np.datetime64):
        return np.asarray((stamps[:] - stamps[0]) / np.timedelta64(1, "ns") * 1e-9)
    unit = next((str(stamps.properties[key]) for key in UNIT_KEYS if stamps.properties.get(key)), "")
    return np.asarray(SECONDS_PER_UNIT[time_unit(stamps.name, unit)] * numbers(stamps[:]))
