"""Small files of every kind that the project reads, each with what reads it: for those who damage them."""

from __future__ import annotations

import contextlib
import shutil
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from unittest import mock
from zlib import crc32

import numpy as np
from dataflash_writer import HEAD, describe, pack
from places import DESIGNS

from cosim.base.errors import InputError


@dataclass(frozen=True)
class Kind:
    """How a whole one is made in a folder, which returns the file that is damaged, and how it is read."""

    make: Callable[[Path], Path]
    read: Callable[[Path], object]
    text: bool = False  # words and numbers are exchanged too


def by(name: str) -> Callable[[Path], object]:
    """Read by the function ``module:function``, which is imported when it is needed."""
    return lambda path: resolve_name(name)(path)


def _log(path: Path) -> None:
    from hexjet_identify.logs import read_flight_log, reader
    from hexjet_identify.logs.log_columns import as_columns

    with mock.patch.object(reader, "MAX_CPU_S", 3.0):
        log = read_flight_log(path)
    log.to_dict()
    with contextlib.suppress(InputError):
        as_columns(log)


def read_here(name: str, path: Path, *numbers: int) -> object:
    """What the process of the reader would answer, without it: one for each of many files takes long."""
    from hexjet_identify.logs import reader

    content = reader.read_here(name, path, *numbers)
    if isinstance(content, str):
        raise InputError(content)
    return content


def _log_here(path: Path) -> None:
    from hexjet_identify.logs import read

    with mock.patch.object(read, "read_apart", read_here):
        _log(path)


def _written(name: str, content: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return make


def _dataflash() -> bytes:
    made = (
        HEAD + describe(1, "RATE", "Qffff", "TimeUS,RDes,R,ROut,I") + describe(2, "ESC", "QBf", "TimeUS,Instance,RPM")
    )
    made += describe(3, "MSG", "QZ", "TimeUS,Message") + describe(4, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
    made += pack(4, "QBNN", 0, 2, b"s#q", b"F-0") + pack(3, "QZ", 5, b"ArduCopter V4.6")
    for n in range(120):
        made += pack(1, "Qffff", 10_000 * n, 0.1 * n, n, -n, 0.01 * n) + pack(2, "QBf", 10_000 * n, n % 4, 100.0 + n)
    return made


def _crazyflie() -> bytes:
    made = struct.pack("<BHH", 0xBC, 2, 2) + struct.pack("<H", 7) + b"rate\0" + struct.pack("<H", 2)
    made += b"gyro.x(f)\0motor.m1(I)\0" + struct.pack("<H", 9) + b"slow\0" + struct.pack("<H", 1) + b"pm.vbat(f)\0"
    for n in range(120):
        made += struct.pack("<H", 7) + struct.pack("<QfI", 10_000 * n, 0.1 * n, 1000 + n)
        made += struct.pack("<H", 9) + struct.pack("<Qf", 10_000 * n, 3.7) if n % 20 == 0 else b""
    return made + struct.pack("<I", crc32(made))


def _blackbox() -> bytes:
    from blackbox_writer import END, FIELDS, SLOW, Writer, beside

    count = np.arange(120)
    table = {"loopIteration": 2 * count, "time": 10**6 + 500 * count}
    table |= {f.name: (37 * count * (n + 1)) % 900 for n, f in enumerate(FIELDS[2:])}
    writer = Writer(every=16, of=2)
    frames = writer.frames(table)
    return writer.head() + SLOW + b"".join(frames[:60]) + beside(5) + b"".join(frames[60:]) + END


def _tlog() -> bytes:
    from pymavlink.dialects.v20 import ardupilotmega as messages

    mav, made = messages.MAVLink(None, 1, 1), b""
    for n in range(60):
        sent = [messages.MAVLink_attitude_message(20 * n, 0.1 * n, 0, 0, 0, 0, 0)]
        sent += [messages.MAVLink_servo_output_raw_message(20_000 * n, 0, *[1500] * 8, *[0] * 8)]
        sent += [messages.MAVLink_statustext_message(6, b"landed")] if n % 20 == 0 else []
        for message in sent:
            made += struct.pack(">Q", 1_700_000_000_000_000 + 20_000 * n) + message.pack(mav, force_mavlink1=n % 2 == 1)
    return made


def _csv() -> bytes:
    rows = (f"{0.01 * n:.3f}, {n % 7}, {n / 8:.2f}, 2026-11-25 12:00:{n % 60:02d}" for n in range(120))
    return "\n".join(["time (s), u, gyro[0] (deg/s), date", *rows]).encode()


def _run(folder: Path) -> Path:
    """A made-up run of 120 steps; its folder."""
    from flights import record

    record(120, folder / "run")
    return folder / "run"


def _exported(kind: str, name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        from cosim.results.export import export_log

        run = _run(folder)
        export_log(kind, run, folder / name)
        shutil.rmtree(run)
        return folder / name

    return make


def _parquet(folder: Path) -> Path:
    from cosim.results.log.arrow import write_table

    rows = [0.01 * n for n in range(120)]
    write_table(folder / "bench.parquet", {"time": rows, "u": rows, "name": [str(row) for row in rows]})
    return folder / "bench.parquet"


def _open_run(path: Path) -> None:
    from cosim.results.run import open_run

    run = open_run(path.parent)
    for name in run.log.columns:
        len(run.log[name])


def _of_run(name: str) -> Callable[[Path], Path]:
    return lambda folder: _run(folder) / name


def _killed(folder: Path) -> Path:
    """A run that was killed: its stream of rows is all there is."""
    from flights import samples, scenario, setup

    from cosim.results.run import begin_run

    recording = begin_run(setup(), scenario(), folder / "run")
    for sample in samples(120):
        recording.observe(sample)
    whole = folder / "kept"
    shutil.copytree(folder / "run", whole)
    recording.finish("completed", "")
    shutil.rmtree(folder / "run")
    whole.rename(folder / "run")
    return next((folder / "run").glob("*.arrows"))


def _shipped(*parts: str) -> Callable[[Path], Path]:
    from cosim.base.storage.paths import data_folder

    def make(folder: Path) -> Path:
        source = data_folder(parts[0]).joinpath(*parts[1:])
        shutil.copy(source, folder / source.name)
        return folder / source.name

    return make


def _vehicle(folder: Path) -> Path:
    from cosim.base.storage.paths import data_folder

    shutil.copytree(data_folder("aircraft") / "hexjet", folder / "mine")
    file = folder / "mine" / "vehicle.toml"
    file.write_text(file.read_text().replace('name = "hexjet"', 'name = "mine"'))
    return file


def _model_file(folder: Path) -> Path:
    from cosim.base.storage.toml import toml_text
    from cosim.identify.sweep.fit import Model

    model = Model(300.0, 0.3, (0.05,), 20.5, 0.004).discrete("made up").model_dump(mode="json", exclude_none=True)
    (folder / "model.toml").write_text(toml_text({"identified": {"edf": {"roll": model}}}))
    return folder / "model.toml"


def _fmu(folder: Path) -> Path:
    from cosim.base.storage.paths import data_folder

    shutil.copy(data_folder("fmus") / "turbojet.fmu", folder / "engine.fmu")
    return folder / "engine.fmu"


def _described_fmu(folder: Path) -> Path:
    """The description apart, which :func:`_read_described` puts back."""
    with zipfile.ZipFile(_fmu(folder)) as archive:
        (folder / "modelDescription.xml").write_bytes(archive.read("modelDescription.xml"))
    return folder / "modelDescription.xml"


def _read_described(path: Path) -> None:
    """The FMU that has this description, and no library: nothing of it could run."""
    with zipfile.ZipFile(path.with_name("engine.fmu")) as whole, zipfile.ZipFile(path.with_name("x.fmu"), "w") as made:
        for name in whole.namelist():
            made.writestr(name, path.read_bytes() if name == path.name else whole.read(name))
    read_fmu(path.with_name("x.fmu"))


read_fmu = by("cosim.engine.fmu.archive:read_archive")


def _mapping(folder: Path) -> Path:
    _fmu(folder)
    text = 'fmu = "engine.fmu"\ntitle = "Somebody\'s engine"\n\n[ports]\nthrottle = "throttle"\nthrust = "thrust"\n\n'
    (folder / "theirs.toml").write_text(f"{text}[range]\nthrottle = [0.0, 1.0]\n")
    return folder / "theirs.toml"


def _read_mapping(path: Path) -> None:
    from cosim.engine.fmu.archive import read_archive
    from cosim.engine.fmu.mapping import read_mapping

    _, archive, ports = read_mapping(path)
    read_archive(archive, ports)


KINDS = {
    "dataflash": Kind(_written("flight.bin", _dataflash()), _log_here),
    "ulog": Kind(_exported("ulog", "flight.ulg"), _log),
    "mat": Kind(_exported("mat", "flight.mat"), _log),
    "blackbox": Kind(_written("LOG00001.BFL", _blackbox()), _log_here, text=True),
    "crazyflie": Kind(_written("log00", _crazyflie()), _log_here),
    "tlog": Kind(_written("flight.tlog", _tlog()), _log_here),
    "csv": Kind(_written("bench.csv", _csv()), _log_here, text=True),
    "parquet": Kind(_parquet, _log_here),
    "summary": Kind(_of_run("summary.json"), _open_run, text=True),
    "rows": Kind(_of_run("flight.parquet"), _open_run),
    "stream": Kind(_killed, _open_run),
    "scenario": Kind(_shipped("scenarios", "fault-flame-out.toml"), by("cosim.spec.scenario:Scenario.load"), text=True),
    "vehicle": Kind(_vehicle, lambda path: resolve_name("cosim.spec.vehicle.files:load_vehicle")(str(path)), text=True),
    "study": Kind(
        _shipped("studies", "predictor-robustness.toml"), by("cosim.campaign.study.study:Study.load"), text=True
    ),
    "controller": Kind(
        _written("design.toml", (DESIGNS / "turbojet.toml").read_bytes()),
        by("cosim.simulation.controllers.controller_file:read_controller"),
        text=True,
    ),
    "model": Kind(_model_file, by("hexjet_identify.prediction_error.validate:read_model"), text=True),
    "fmu": Kind(_fmu, read_fmu),
    "mapping": Kind(_mapping, _read_mapping, text=True),
    "description": Kind(_described_fmu, _read_described, text=True),
}
