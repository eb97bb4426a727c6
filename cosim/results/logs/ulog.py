"""ULog, as PX4 writes it, read by pyulog."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.storage.files import one_line
from cosim.results.logs.flight_log import Channel, FlightLog, numbers


def recognises(head: bytes) -> bool:
    """Whether a file begins so."""
    return head.startswith(b"ULog\x01\x12\x35")


def read(path: Path) -> FlightLog:
    """Every topic's fields as ``topic.field``, those of further instances as ``topic#1.field``.

    Times are those of ``timestamp_sample`` where a topic has it: when it was measured, not when it was published.
    Raises InputError.
    """
    try:
        from pyulog import ULog
    except ModuleNotFoundError as error:
        if error.name != "pyulog":
            raise
        raise InputError("a ULog needs pyulog, which is not installed: pip install 'hexjet-cosim[logs]'") from None
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), path.open("rb") as file:
            log = ULog(file)
    except Exception as error:  # what the library raises for a file that is wrong is of no one kind
        raise InputError(f"{path}: cannot be read as ULog: {one_line(error)}") from error
    channels = {}
    untimed: list[str] = []
    for topic in log.data_list:
        stamp = topic.data.get("timestamp_sample", topic.data.get("timestamp"))
        if stamp is None:
            untimed.append(topic.name)
            continue
        times = 1e-6 * np.asarray(stamp, np.float64)
        if topic.name == "hexjet_thrust":  # ours: what the engine has at the end of the step that the message is of
            times = times + _step(log, times)
        name = topic.name + (f"#{topic.multi_id}" if topic.multi_id else "")
        for field, values in topic.data.items():
            if not field.startswith("timestamp"):
                channels[f"{name}.{field}"] = Channel(times, numbers(values))
    if not channels:
        raise InputError(f"{path}: the ULog holds no data: it was cut short before the first message, or damaged")
    remarks = [f"left out, having no time: {', '.join(untimed)}"] if untimed else []
    if log.file_corruption or output.getvalue().strip():
        remarks.append("parts of the file are damaged and were passed over")
    if log.dropouts:
        lost = 1e-3 * sum(dropout.duration for dropout in log.dropouts)
        remarks.append(f"{len(log.dropouts)} times the logger lost data, {lost:.1f} s together")
    events = [(1e-6 * message.timestamp, str(message.message)) for message in log.logged_messages]
    return FlightLog(path, "ULog", channels, tuple(remarks), events)


def _step(log: Any, times: Array) -> float:
    """The control step of a log of ours: stated where it is not the default, which is as often as rows are written."""
    stated = log.initial_parameters.get("step_s")
    if stated is not None or times.size < 2:
        return float(stated or 0.0)
    return float(np.median(np.diff(times)))
