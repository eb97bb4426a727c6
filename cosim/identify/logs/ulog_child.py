"""The process in which pyulog reads a ULog: started by ``cosim.identify.logs.ulog``, and by nobody else.

It imports nothing of the package: what that takes to load would be more than most logs take to be read.  It writes one
line of JSON, then each topic's columns as doubles, its stamps first.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

Columns = NDArray[np.float64]


class DamagedError(Exception):
    """A log that cannot be read; the message says why."""


class _Remainder(io.BytesIO):
    """The rest of a file, which refuses as a file does to go back to before its beginning; BytesIO stops there.

    pyulog goes back by what a damaged message says, and would come to it again for ever.
    """

    def seek(self, offset: int, whence: int = 0, /) -> int:
        if whence == io.SEEK_CUR and self.tell() + offset < 0:
            raise OSError("before the beginning")
        return super().seek(offset, whence)


def _load(file: IO[bytes], begin: int) -> Any:
    """Load the log with pyulog.  Raises DamagedError with the byte of the file by which it stopped."""
    from pyulog import ULog
    from pyulog.core import ULogException

    source = _Remainder(file.read()[begin:]) if begin else file
    try:
        return ULog(source)
    except ULogException as error:
        raise DamagedError(str(error)) from error
    except Exception as error:  # for a file that is wrong it raises whatever its own calls raise, in their words
        raise DamagedError(f"it is damaged at byte {begin + source.tell()} or before that") from error


def read(path: Path, begin: int) -> tuple[dict[str, Any], list[Columns]]:
    """Read the log that begins at a byte: its facts, and the columns of its topics.  Raises DamagedError.

    What is in the log and fits nothing raises whatever it may.
    """
    output = io.StringIO()
    with contextlib.redirect_stdout(output), path.open("rb") as file:
        log = _load(file, begin)
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
    header = {
        "topics": topics,
        "untimed": untimed,
        "step": None if step is None else float(step),
        "damaged": bool(log.file_corruption or output.getvalue().strip()),
        "lost": [int(dropout.duration) for dropout in log.dropouts],
        "events": [[int(message.timestamp), str(message.message)] for message in log.logged_messages],
    }
    return header, columns


def _doubles(values: Any) -> Columns:
    with np.errstate(invalid="ignore"):
        return np.asarray(values).astype("<f8")


def main(path: Path, begin: int) -> None:
    """Write on standard output what is in the log, or why it cannot be read."""
    columns: list[Columns] = []
    try:
        header, columns = read(path, begin)
    except DamagedError as error:
        header = {"error": " ".join(str(error).split())}
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        header = {"error": f"it is damaged: what it says of itself does not fit together ({reason})"}
    out = sys.stdout.buffer
    out.write(json.dumps(header).encode() + b"\n")
    for table in columns:
        out.write(np.ascontiguousarray(table).data)
    out.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
