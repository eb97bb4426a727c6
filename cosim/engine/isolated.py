"""Engines in a process of their own, so that an FMU can harm no other process.

A crash, a hang, a library's own threads or run time, a flood on standard output: the flight ends as failed, with
engine, step and time, and its log is kept.  The numbers that go to and fro are the same doubles, so a flight is the one
that it is without, bit for bit; what it costs is one exchange through two pipes a step.
"""

from __future__ import annotations

import atexit
import json
import os
import pickle
import struct
import subprocess
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from math import inf
from time import monotonic
from typing import Any, NamedTuple

from cosim.base.errors import EngineError, InputError
from cosim.base.protocols import Column
from cosim.base.runtime.host import Host, HostError, die_with_parent, measure_megabytes, python_command, serve_pipes
from cosim.base.signals import Ambient, EngineOutput, PerJet
from cosim.base.storage.scratch import scratch
from cosim.engine.bank import EngineBank, make_log_columns
from cosim.engine.fmu.air import Air
from cosim.engine.fmu.archive import Archive
from cosim.engine.fmu.instance import FmuInstance
from cosim.engine.fmu.port_kinds import AMBIENT
from cosim.engine.fmu.starting import Setting
from cosim.engine.fmu.unpacked import unpack
from cosim.engine.measure import EngineMeasurement, make_measurement_adapter, measure
from cosim.engine.spec import EngineSpec


class HostLimits(NamedTuple):
    """Limits of an engine's own process."""

    # Time [s] for one step of all engines: a thousand control steps.
    hang_s: float = 4.0
    # Time [s] to load, start, measure or warm up engines.
    start_s: float = 120.0
    close_s: float = 2.0  # s to free the instances
    # Resident memory [MB] of the process with the engines: good engines need about ten.
    max_megabytes: float = 1024.0
    # Resident memory [MB] up to which a process is kept for further engines: a leak is not passed on.
    max_idle_megabytes: float = 256.0
    max_answer_bytes: int = 2**24
    max_request_bytes: int = 2**32


LIMITS = HostLimits()  # limits of the engines' process


Moment = str | tuple[int, float]  # phase in words, or step and time [s]
_SERVE_CODE = "from cosim.engine.isolated import serve; serve()"  # code of the engines' process


class EngineHost:
    """Process that runs engines of some archives, for one bank after another.

    Raises EngineError where it ends by itself, does not answer, or is asked after ``deadline`` (of ``time.monotonic``).
    """

    def __init__(self, archives: Iterable[Archive], deadline: float = inf) -> None:
        listed = list(archives)
        self.archives = frozenset(archive.sha256 for archive in listed)
        self.label = ""  # text before each error
        self._folder = os.stat(".")  # working folder, for relative paths
        # Files that the process leaves when killed are deleted with this process's temporary files.
        environ = dict(os.environ) | {"TMPDIR": str(scratch())}
        self._host = Host.open(python_command(_SERVE_CODE), environ, LIMITS.max_megabytes, stderr=subprocess.DEVNULL)
        self._deadline = deadline
        self.is_sound = True  # True: no error so far

    @property
    def is_reusable(self) -> bool:
        """Whether the process may serve further engines of its archives."""
        small = measure_megabytes(self._host.pid) <= LIMITS.max_idle_megabytes
        is_here = os.path.samestat(self._folder, os.stat("."))
        return self.is_sound and small and is_here and self._deadline == inf and self._host.poll() is None

    def call(self, question: tuple[Any, ...], limit: float, moment: Moment) -> Any:
        """Return the answer to a question as JSON values, or raise the error that occurred in the process."""
        return self._read(self.request(question, limit, moment))

    def request(self, question: tuple[Any, ...], limit: float, moment: Moment) -> bytes:
        return self.exchange(b"p" + pickle.dumps(question), limit, moment)

    def exchange(self, data: bytes, limit: float, moment: Moment) -> bytes:
        """Send bytes and return the answer; ``moment`` describes the time for errors."""
        if self._deadline < inf:
            limit = min(limit, max(0.0, self._deadline - monotonic()))
        try:
            return self._host.exchange_message(data, LIMITS.max_answer_bytes, limit)
        except HostError as error:
            self.end(0.0)
            when = moment if isinstance(moment, str) else "at step {} ({:g} s)".format(*moment)
            raise EngineError(f"{self.label}{error} {when}") from None

    def doubles(self, data: bytes, form: struct.Struct) -> tuple[float, ...]:
        """Return the numbers of an answer, bit for bit, or raise the error that occurred in the process."""
        if data[:1] == b"p":
            self._read(data)
        if data[:1] != b"s" or len(data) != 1 + form.size:
            raise self.make_invalid_answer_error()
        return form.unpack_from(data, 1)

    def _read(self, data: bytes) -> Any:
        """Return the JSON values of an answer, or raise the error that it has.

        An FMU's library can send whatever it likes from there: no answer may run anything here, so none is unpickled.
        """
        try:
            good, answer = json.loads(data.removeprefix(b"p"))
            kind, text = ("", "") if good else map(str, answer)
        except (ValueError, TypeError, RecursionError):
            raise self.make_invalid_answer_error() from None
        if good:
            return answer
        self.is_sound = False
        raise {"InputError": InputError, "ValueError": ValueError}.get(kind, EngineError)(text)

    def make_invalid_answer_error(self) -> EngineError:
        self.is_sound = False
        return EngineError(f"{self.label}the process answered what is no answer")

    def end(self, patience: float = LIMITS.close_s) -> None:
        """End the process, by force after ``patience`` s.  May be called again."""
        self.is_sound = False
        self._host.end(patience)


# One process at most waits for further engines: starting one costs as much as seconds of flight.
_idle: list[EngineHost] = []


def acquire_host(archives: Iterable[Archive]) -> EngineHost:
    """Return a process for engines: the idle one if it served exactly these archives, else a new one."""
    listed = list(archives)
    while _idle:
        host = _idle.pop()
        if host.archives == frozenset(archive.sha256 for archive in listed) and host.is_reusable:
            return host
        host.end()
    return EngineHost(listed)


def release_host(host: EngineHost) -> None:
    """Keep a process for further engines, or end it.

    One that another thread than the main one has started ends with that thread.
    """
    if not _idle and threading.current_thread() is threading.main_thread() and host.is_reusable:
        _idle.append(host)
    else:
        host.end()


@atexit.register
def end_idle() -> None:
    while _idle:
        _idle.pop().end()


def _forget_idle() -> None:
    """Leave the idle process to the parent process, after a fork."""
    for host in _idle:
        host._host.returncode = 0
    _idle.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_idle)


def measure_in(
    host: EngineHost, archive: Archive, settings: tuple[Setting, ...], step: float, air: Air, small: bool
) -> EngineMeasurement:
    """Return an engine's measurement by :func:`cosim.engine.measure.measure`, made in an engines' process."""
    question = ("measure", archive, settings, archive.start, step, air, small)
    answer = host.call(question, LIMITS.start_s, "while its thrust was measured")
    try:
        return make_measurement_adapter().validate_python(answer)
    except ValueError:
        raise host.make_invalid_answer_error() from None


class IsolatedBank:
    """Bank of engines in a process of their own, with the methods of :class:`cosim.engine.EngineBank`.

    ``host``: that process; without one it is taken and left by :func:`acquire_host` and :func:`release_host`.
    Raises InputError or EngineError as that does; EngineError too where the process ends by itself or does not answer.
    """

    def __init__(self, specs: Sequence[EngineSpec], step: float, host: EngineHost | None = None) -> None:
        self._step_engines, self._count = step, len(specs)
        self.wants_ambient = any(spec.has_port(port) for spec in specs for port in AMBIENT)
        self._columns = make_log_columns(specs)
        self._row, self._answer = _frame_formats(self._count)
        size = self._count
        self._parts = [slice(i * size, (i + 1) * size) for i in range(len(EngineOutput._fields))]  # parts of the answer
        self._no_air = (0.0,) * (3 + self._count)
        self._is_own = host is None
        self._host: EngineHost | None = host or acquire_host(spec.archive for spec in specs)
        if host is None:
            self.host.label = f"engines ({', '.join(dict.fromkeys(spec.path.name for spec in specs))}): "
        # The uncertainty is left out, because the process would need numpy to read it.
        told = tuple(replace(spec, uncertainty=None, uncertain_ranges=()) for spec in specs)
        try:
            self._call_host(("make", told, step), LIMITS.start_s, "when it was loaded")
        except BaseException:
            self.host.is_sound = False
            self.close()
            raise

    @property
    def host(self) -> EngineHost:
        if self._host is None:
            raise EngineError("the engines were freed before")
        return self._host

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        """Bring each engine to equilibrium at the throttle, ready for step 0."""
        held = tuple(throttle) if isinstance(throttle, Sequence) else throttle
        air = None if ambient is None else (ambient.pressure, ambient.temperature, tuple(ambient.air_speed))
        return self._unpack_output(self.host.request(("reset", held, air), LIMITS.start_s, "before the flight"))

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        """Advance all engines by step ``k`` with inputs held, and return the reports at its end."""
        if ambient is None:
            row = self._row.pack(b"s", k, *throttle, *self._no_air)
        else:
            row = self._row.pack(b"s", k, *throttle, 1.0, ambient[0], ambient[1], *ambient[2])
        return self._unpack_output(self.host.exchange(row, LIMITS.hang_s, (k, k * self._step_engines)))

    def follow(self, station: int, throttles: Iterable[float]) -> list[float]:
        """Return one engine's thrusts [N] for a sequence of throttles, as :meth:`EngineBank.follow`."""
        listed = list(throttles)
        data = self.host.request(("follow", station, listed), LIMITS.start_s, f"within {len(listed)} steps")
        return list(self.host.doubles(data, struct.Struct(f"<{len(listed)}d")))

    @property
    def columns(self) -> tuple[Column, ...]:
        """Log columns of further outputs, as :attr:`EngineBank.columns`."""
        return self._columns

    @property
    def shown(self) -> tuple[float, ...]:
        """Values of :attr:`columns`, as :attr:`EngineBank.shown`; they cost one more exchange per step."""
        data = self.host.request(("shown",), LIMITS.hang_s, "when its further outputs were read")
        return self.host.doubles(data, struct.Struct(f"<{len(self._columns)}d"))

    def run_down(self, seconds: float) -> EngineOutput:
        """Step the engines with closed throttle before the flight, as :meth:`EngineBank.run_down`."""
        return self._unpack_output(self.host.request(("run down", seconds), LIMITS.start_s, "before the flight"))

    def set_run(self, index: int, on: bool) -> bool:
        """Switch one engine off or on, as :meth:`EngineBank.set_run`."""
        return bool(self._call_host(("run", index, on), LIMITS.hang_s, "when it was shut off or on"))

    def close(self) -> None:
        """Free the engines.  May be called again."""
        host, self._host = self._host, None
        if host is None:
            return
        if host.is_sound:
            with suppress(EngineError, ValueError):
                host.call(("close",), LIMITS.close_s, "when it was freed")
        if self._is_own:
            release_host(host)

    def __enter__(self) -> IsolatedBank:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _call_host(self, question: tuple[Any, ...], limit: float, moment: Moment) -> Any:
        return self.host.call(question, limit, moment)

    def _unpack_output(self, data: bytes) -> EngineOutput:
        values = self.host.doubles(data, self._answer)
        return EngineOutput(*[values[part] for part in self._parts])


def make_bank(specs: Sequence[EngineSpec], step: float) -> EngineBank | IsolatedBank:
    """Return a bank of engines, in another process if one of them is isolated.

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
    """Return an answer other than numbers packed as JSON, which cannot execute code when read."""
    return b"p" + json.dumps((good, answer)).encode()


def _double_answer(values: Sequence[float]) -> bytes:
    return b"s" + struct.pack(f"<{len(values)}d", *values)


class _Server:
    """Server in the engines' process, which has a bank and answers requests."""

    def __init__(self) -> None:
        self._bank: EngineBank | None = None
        self._row = self._doubles = struct.Struct("")
        self._count = 0
        self._answers: Mapping[str, Callable[..., bytes]] = {
            "make": self._make_engines,
            "load": self._load_archive,
            "measure": self._measure_engine,
            "reset": self._reset_engines,
            "follow": lambda *arguments: _double_answer(self.bank.follow(*arguments)),
            "run down": lambda seconds: _double_answer(list(chain(*self.bank.run_down(seconds)))),
            "shown": lambda: _double_answer(self.bank.shown),
            "run": lambda *arguments: _json_answer(True, self.bank.set_run(*arguments)),
            "close": self._close_bank,
        }

    @property
    def bank(self) -> EngineBank:
        """The bank that was made last.  Raises EngineError before the first."""
        if self._bank is None:
            raise EngineError("no engines were made")
        return self._bank

    def answer(self, data: bytes) -> bytes:
        """Return the packed answer to a request, or the packed error."""
        try:
            if data[:1] == b"s":
                return self._step_engines(data)
            what, *arguments = pickle.loads(data[1:])
            return self._answers[what](*arguments)
        except Exception as error:
            return _json_answer(False, (type(error).__name__, str(error)))

    def _step_engines(self, data: bytes) -> bytes:
        count = self._count
        row = self._row.unpack(data)
        k, values = row[1], row[2:]
        ambient = Ambient(values[count + 1], values[count + 2], values[count + 3 :]) if values[count] else None
        output = self.bank.step(k, values[:count], ambient)
        return b"s" + self._doubles.pack(*chain.from_iterable(output))

    def _make_engines(self, specs: Sequence[EngineSpec], step: float) -> bytes:
        self._close_bank()
        self._count = len(specs)
        self._row, self._doubles = _frame_formats(self._count)
        self._bank = EngineBank(specs, self._count, step)
        return _json_answer(True, None)

    def _load_archive(self, archive: Archive) -> bytes:
        self._close_bank()
        with unpack(archive) as folder:
            FmuInstance(archive, folder, "checked").close()
        return _json_answer(True, None)

    def _measure_engine(self, *arguments: Any) -> bytes:
        self._close_bank()
        return _json_answer(True, measure(*arguments))

    def _reset_engines(self, throttle: float | Sequence[float], air: Any) -> bytes:
        return _double_answer(list(chain(*self.bank.reset(throttle, Ambient(*air) if air else None))))

    def _close_bank(self) -> bytes:
        if self._bank is not None:
            self._bank.close()
            self._bank = None
        return _json_answer(True, None)


def serve() -> None:
    """Run as the engines' process: answer requests until the pipe is closed."""
    pipes, server = serve_pipes(), _Server()
    die_with_parent()
    with suppress(EOFError, OSError):
        while True:
            pipes.send_message(server.answer(pipes.receive_message(LIMITS.max_request_bytes)))
    server.answer(b"p" + pickle.dumps(("close",)))
