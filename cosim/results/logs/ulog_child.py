"""The process in which pyulog reads a ULog: started by ``cosim.results.logs.ulog``, and by nobody else.

It imports nothing of the package: what that takes to load would be more than most logs take to be read.  It writes one
line of JSON, then each topic's columns as doubles, its stamps first.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = NDArray[np.float64]


def read(path: Path, begin: int) -> tuple[dict[str, Any], list[Columns]]:
    """What the log that begins at a byte says, and the columns of its topics; raises whatever pyulog does."""
    from pyulog import ULog

    output = io.StringIO()
    with contextlib.redirect_stdout(output), path.open("rb") as file:
        log = ULog(io.BytesIO(file.read()[begin:]) if begin else file)
    topics: list[dict[str, Any]] = []
    columns: list[Columns] = []
    untimed: list[str] = []
    for topic in log.data_list:
        stamp = topic.data.get("timestamp_sample", topic.data.get("timestamp"))
        if stamp is None:
            untimed.append(topic.name)
            continue
        fields = [field for field in topic.data if not field.startswith("timestamp")]
        topics.append({"name": topic.name, "instance": topic.multi_id, "fields": fields, "rows": len(stamp)})
        columns.append(np.stack([_doubles(stamp), *(_doubles(topic.data[field]) for field in fields)]))
    step = log.initial_parameters.get("step_s")
    said = {
        "topics": topics,
        "untimed": untimed,
        "step": None if step is None else float(step),
        "damaged": bool(log.file_corruption or output.getvalue().strip()),
        "lost": [int(dropout.duration) for dropout in log.dropouts],
        "events": [[int(message.timestamp), str(message.message)] for message in log.logged_messages],
    }
    return said, columns


def _doubles(values: Any) -> Columns:
    with np.errstate(invalid="ignore"):
        return np.asarray(values).astype("<f8")


def main(path: Path, begin: int) -> None:
    """Write on standard output what is in the log, or why it cannot be read."""
    columns: list[Columns] = []
    try:
        said, columns = read(path, begin)
    except Exception as error:  # what the library raises for a file that is wrong is of no one kind
        said = {"error": (str(error).splitlines() or [type(error).__name__])[0] or type(error).__name__}
    out = sys.stdout.buffer
    out.write(json.dumps(said).encode() + b"\n")
    for table in columns:
        out.write(np.ascontiguousarray(table).data)
    out.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
