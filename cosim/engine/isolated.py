"""A bank of engines in a process of its own, so that an FMU can harm no other process.

A crash, a hang, a library's own threads or run time, a flood on standard output: the flight ends as failed, with
engine, step and time, and its log is kept.  The numbers that go to and fro are the same doubles, so a flight is the one
that it is without, bit for bit; what it costs is one exchange through two pipes a step.
"""

from __future__ import annotations

import json
import os
import pickle
import struct
from collections.abc import Sequence
from contextlib import suppress
from itertools import chain
from typing import Any

from cosim.base.errors import EngineError, InputError
from cosim.base.protocols import Column
from cosim.base.runtime.pipes import Pipes
from cosim.base.runtime.processes import Child, die_with_parent, measure_megabytes
from cosim.base.signals import Ambient, EngineOutput, PerJet
from cosim.engine.bank import EngineBank, make_log_columns
from cosim.engine.fmu.port_kinds import AMBIENT
from cosim.engine.spec import EngineSpec

HANG_S = 4.0  # for one step of all engines; chosen by us: a thousand control steps
START_S = 120.0  # to be loaded, started and run up, which a flight does once
CLOSE_S = 2.0  # to be freed
MAX_MEGABYTES = 1024.0  # resident, of the engines' process: as cosim.engine.qualify.supervisor.Limits
MAX_ANSWER_BYTES = 2**20
MEMORY_CHECK_STEPS = 250  # a second of control steps
_ANY = 2**32  # bytes of a question, which is ours
_SERVE = "from cosim.engine.isolated import serve; serve(*map(int, sys.argv[1:]))"


class IsolatedBank:
    """As :class:`cosim.engine.EngineBank`, with the engines in a child process.

    Raises InputError or EngineError as that does; EngineError too where the child ends by itself or does not answer.
    """

    def __init__(self, specs: Sequence[EngineSpec], step: float) -> None:
        self._step, self._count = step, len(specs)
        self._names = ", ".join(dict.fromkeys(spec.path.name for spec in specs))
        self.wants_ambient = any(spec.has_port(port) for spec in specs for port in AMBIENT)
        self._columns = make_log_columns(specs)
        self._row, self._answer = _frame_formats(self._count)
        size = self._count
        self._parts = [slice(i * size, (i + 1) * size) for i in range(len(EngineOutput._fields))]  # of the answer
        self._no_air = (0.0,) * (3 + self._count)
        self._child, self._pipes = Child.open_pipes(_SERVE)
        try:
            self._call(("make", tuple(specs), step), START_S, "when it was loaded")
        except BaseException:
            self.close()
            raise

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        """As the bank's."""
        held = tuple(throttle) if isinstance(throttle, Sequence) else throttle
        air = None if ambient is None else (ambient.pressure, ambient.temperature, tuple(ambient.air_speed))
        return self._output(self._request(("reset", held, air), START_S, "before the flight"))

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        """As the bank's."""
        if ambient is None:
            row = self._row.pack(b"s", k, *throttle, *self._no_air)
        else:
            row = self._row.pack(b"s", k, *throttle, 1.0, ambient[0], ambient[1], *ambient[2])
        return self._output(self._exchange(row, HANG_S, k))

    @property
    def columns(self) -> tuple[Column, ...]:
        """As the bank's."""
        return self._columns

    @property
    def shown(self) -> tuple[float, ...]:
        """As the bank's; one more passage in every step, where there is something to show."""
        data = self._request(("shown",), HANG_S, "when its further outputs were read")
        return self._doubles(data, struct.Struct(f"<{len(self._columns)}d"))

    def run_down(self, seconds: float) -> EngineOutput:
        """As the bank's."""
        return self._output(self._request(("run down", seconds), START_S, "before the flight"))

    def set_run(self, index: int, on: bool) -> bool:
        """As the bank's."""
        return bool(self._call(("run", index, on), HANG_S, "when it was shut off or on"))

    def close(self) -> None:
        """End the child, by force if it takes long.  May be called again."""
        self._pipes.close()
        self._child.end(CLOSE_S)

    def __enter__(self) -> IsolatedBank:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _call(self, question: tuple[Any, ...], limit: float, moment: str | int) -> Any:
        return self._read(self._request(question, limit, moment))

    def _request(self, question: tuple[Any, ...], limit: float, moment: str | int) -> bytes:
        return self._exchange(b"p" + pickle.dumps(question), limit, moment)

    def _read(self, data: bytes) -> Any:
        """Return what the child answered, tuples as lists, or raise the error that it met.

        An FMU's library can send whatever it likes from there: no answer may run anything here, so none is unpickled.
        """
        try:
            good, answer = json.loads(data.removeprefix(b"p"))
            kind, text = ("", "") if good else map(str, answer)
        except (ValueError, TypeError, RecursionError):
            raise self._invalid_answer() from None
        if good:
            return answer
        raise {"InputError": InputError, "ValueError": ValueError}.get(kind, EngineError)(text)

    def _doubles(self, data: bytes, form: struct.Struct) -> tuple[float, ...]:
        """Return the numbers that were answered, the same bits; raises what the child met in place of them."""
        if data[:1] == b"p":
            self._read(data)
        if data[:1] != b"s" or len(data) != 1 + form.size:
            raise self._invalid_answer()
        return form.unpack_from(data, 1)

    def _output(self, data: bytes) -> EngineOutput:
        values = self._doubles(data, self._answer)
        return EngineOutput(*[values[part] for part in self._parts])

    def _invalid_answer(self) -> EngineError:
        return EngineError(f"engines ({self._names}): their process answered what is no answer")

    def _exchange(self, data: bytes, limit: float, moment: str | int) -> bytes:
        """Send a request and return the answer; ``moment`` is when, for an error: words, or the step's number."""
        try:
            return self._pipes.exchange_message(data, MAX_ANSWER_BYTES, limit)
        except ValueError:
            raise self._invalid_answer() from None
        except TimeoutError:
            self._child.end()
            end = f"no answer within {limit:g} s {self._describe(moment)}: a call to the FMU hangs"
        except (EOFError, OSError):
            crashed, left = "its process crashed ({})", "its process ended by itself (exit status {})"
            end = self._child.describe_end(CLOSE_S, crashed, left) or "its process no longer answers"
            end = f"{end} {self._describe(moment)}"
        raise EngineError(f"engines ({self._names}): {end}")

    def _describe(self, moment: str | int) -> str:
        return f"at step {moment} ({moment * self._step:g} s)" if isinstance(moment, int) else moment


def make_bank(specs: Sequence[EngineSpec], step: float) -> EngineBank | IsolatedBank:
    """Return a bank of engines, in a process of its own where one of them asks for that.

    Raises InputError or EngineError as :class:`cosim.engine.EngineBank` does.
    """
    if any(spec.isolated for spec in specs):
        return IsolatedBank(specs, step)
    return EngineBank(specs, len(specs), step)


def _frame_formats(count: int) -> tuple[struct.Struct, struct.Struct]:
    """Return the binary formats of a step of ``count`` engines and of the numbers of its answer.

    Kind, step, throttles, whether there is air, pressure, temperature and speeds; then what they give, quantity by
    quantity.
    """
    return struct.Struct(f"<cq{2 * count + 3}d"), struct.Struct(f"<{len(EngineOutput._fields) * count}d")


def _json_answer(good: bool, answer: Any) -> bytes:
    """Return an answer that is no row of doubles as JSON, which runs nothing where it is read."""
    return b"p" + json.dumps((good, answer)).encode()


def _double_answer(values: Sequence[float]) -> bytes:
    """Return doubles as they are."""
    return b"s" + struct.pack(f"<{len(values)}d", *values)


class _Server:
    """The child's side: the bank that it made, and its answer to each request."""

    def __init__(self) -> None:
        self.bank: EngineBank | None = None
        self._row = self._doubles = struct.Struct("")
        self._count = 0

    def answer(self, data: bytes) -> bytes:
        try:
            if data[:1] == b"s":
                return self._step(data)
            what, *arguments = pickle.loads(data[1:])
            return self._make(*arguments) if what == "make" else self._other(what, arguments)
        except Exception as error:
            return _json_answer(False, (type(error).__name__, str(error)))

    def _step(self, data: bytes) -> bytes:
        assert self.bank is not None
        count = self._count
        row = self._row.unpack(data)
        k, values = row[1], row[2:]
        ambient = Ambient(values[count + 1], values[count + 2], values[count + 3 :]) if values[count] else None
        output = self.bank.step(k, values[:count], ambient)
        if k % MEMORY_CHECK_STEPS == 0 and (size := measure_megabytes(os.getpid())) > MAX_MEGABYTES:
            much = f"takes {size:.0f} MB of memory at step {k}, {MAX_MEGABYTES:g} MB at most: it leaks"
            raise EngineError(f"engines: their process {much}")
        return b"s" + self._doubles.pack(*chain.from_iterable(output))

    def _make(self, specs: Sequence[EngineSpec], step: float) -> bytes:
        self._count = len(specs)
        self._row, self._doubles = _frame_formats(self._count)
        self.bank = EngineBank(specs, self._count, step)
        return _json_answer(True, None)

    def _other(self, what: str, arguments: Sequence[Any]) -> bytes:
        bank = self.bank
        assert bank is not None
        if what == "reset":
            throttle, air = arguments
            return _double_answer(list(chain(*bank.reset(throttle, Ambient(*air) if air else None))))
        if what == "run down":
            return _double_answer(list(chain(*bank.run_down(*arguments))))
        if what == "shown":
            return _double_answer(bank.shown)
        return _json_answer(True, bank.set_run(*arguments))


def serve(reader: int, writer: int) -> None:
    """Run as the child: make a bank and answer requests until the pipe is closed."""
    die_with_parent()
    pipes, server = Pipes(reader, writer), _Server()
    with suppress(EOFError, OSError):
        while True:
            pipes.send_message(server.answer(pipes.receive_message(_ANY)))
    if server.bank is not None:
        server.bank.close()
