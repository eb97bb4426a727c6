"""Logs that nobody here wrote: what is an instance, names as others give them, what is cut, damaged or endless."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from blackbox_writer import END, Writer
from command_tools import Hexjet
from dataflash_writer import HEAD, describe, pack
from flights import exported, record

from cosim.base.errors import InputError
from hexjet_identify.logs import FlightLog, read_flight_log, reader, signals_of
from hexjet_identify.logs.flight_log import Channel
from hexjet_identify.logs.log_columns import as_columns

pytestmark = pytest.mark.usefixtures("logs_read_here")

TIMES = np.arange(50) * 0.01
WAVE = np.sin(TIMES)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The ULog of a made-up flight."""
    folder = tmp_path_factory.mktemp("flown")
    exported(record(200, folder / "run").folder, folder / "flight.ulg")
    return (folder / "flight.ulg").read_bytes()


def read(path: Path, content: bytes) -> FlightLog:
    path.write_bytes(content)
    return read_flight_log(path)


def dataflash(kind: int, name: str, columns: str, labels: str, rows: list[tuple[float, ...]], units: str = "") -> bytes:
    """One kind of message, described, with what FMTU says of its units where ``units`` are given."""
    made = HEAD + describe(kind, name, columns, labels)
    if units:
        made += describe(7, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
        made += pack(7, "QBNN", 0, kind, units.encode(), b"-" * len(units))
    return made + b"".join(pack(kind, columns, *row) for row in rows)


@pytest.mark.parametrize("units", ["", "s-----"])
def test_an_integrator_is_no_instance(tmp_path: Path, units: str) -> None:
    """PID messages call their integrator I, which has a value of its own in every row."""
    rows = [(10_000 * n, *(float(x) for x in (n, 2 * n, 0.1 * n)), n % 2) for n in range(50)]
    log = read(tmp_path / "x.bin", dataflash(9, "PIDR", "QfffB", "TimeUS,Tar,Act,I,Limit", rows, units[:5]))
    assert list(log.channels) == ["PIDR.Tar", "PIDR.Act", "PIDR.I", "PIDR.Limit"]
    np.testing.assert_allclose(log.channels["PIDR.I"].values, 0.1 * np.arange(50), rtol=1e-6)


@pytest.mark.parametrize(("label", "units"), [("C", "s#-"), ("Instance", ""), ("I", ""), ("I", "s#-")])
def test_instances_are_what_the_log_says(tmp_path: Path, label: str, units: str) -> None:
    """By the unit that FMTU says, whatever the field is called; by its name alone where the log says nothing."""
    rows = [(1000 * n, n % 3, 100.0 * (n % 3) + n) for n in range(60)]
    log = read(tmp_path / "x.bin", dataflash(9, "XKF1", "QBf", f"TimeUS,{label},PD", rows, units))
    for n in range(3):
        np.testing.assert_array_equal(log.channels[f"XKF1[{n}].PD"].values, 100.0 * n + np.arange(n, 60, 3))
        np.testing.assert_allclose(log.channels[f"XKF1[{n}].PD"].times, 1e-3 * np.arange(n, 60, 3), atol=1e-12)


@pytest.mark.parametrize(("columns", "units"), [("QBf", "s--"), ("Qff", ""), ("QIf", "")])
def test_what_the_log_does_not_call_an_instance_is_none(tmp_path: Path, columns: str, units: str) -> None:
    """Told otherwise by FMTU, no whole number, or a count with more values than a message can have instances."""
    rows = [(1000 * n, n if columns == "QIf" else n % 3, 1.0 * n) for n in range(300)]
    log = read(tmp_path / "x.bin", dataflash(9, "CTUN", columns, "TimeUS,I,PD", rows, units))
    assert list(log.channels) == ["CTUN.I", "CTUN.PD"]


def test_a_dataflash_log_that_is_cut_says_so(tmp_path: Path) -> None:
    rows = [(1000 * n, n % 3, 1.0 * n) for n in range(50)]
    whole = dataflash(9, "CTUN", "QBf", "TimeUS,X,PD", rows)
    assert not read(tmp_path / "x.bin", whole).remarks
    log = read(tmp_path / "x.bin", whole[:-5])
    assert log.remarks == ("the log was cut short, or the power went: it ends 11 bytes into a message",)
    assert len(log.channels["CTUN.PD"].values) == 49


def test_a_name_with_blanks_and_brackets_is_a_channel(tmp_path: Path) -> None:
    channels = {
        "gyroADC[0] (deg/s)": Channel(TIMES, WAVE),
        "y [deg/s]": Channel(TIMES, 2.0 * WAVE),
        "a+b": Channel(TIMES, WAVE),
    }
    log = FlightLog(tmp_path / "x", "table", channels)
    np.testing.assert_array_equal(log.signal("gyroADC[0] (deg/s)").values, WAVE)
    np.testing.assert_array_equal(log.signal("a+b").values, WAVE)
    np.testing.assert_allclose(log.signal("deg('gyroADC[0] (deg/s)')").values, np.radians(WAVE), rtol=1e-15)
    np.testing.assert_allclose(log.signal("""square("y [deg/s]") - 2*'y [deg/s]'""").values, 4 * WAVE**2 - 4 * WAVE)
    assert log.has("'y [deg/s]' + \"a+b\"")
    assert not log.has("'y [deg/s' + 'a+b'")
    with pytest.raises(InputError, match="quotes around a name with blanks or brackets"):
        log.signal("y [deg/s] + 'a+b'")
    with pytest.raises(InputError, match=r"no channel 'y \(deg/s\)'; did you mean 'y \[deg/s\]'"):
        log.signal("deg('y (deg/s)')")


def test_rows_of_a_sum_that_not_all_have_are_left_out_and_counted(tmp_path: Path) -> None:
    """One stamp that is wrong by a microsecond costs its row, and not the log."""
    late, gone = TIMES.copy(), np.delete(TIMES, [3, 4])
    late[20] += 1e-6
    channels = {"a": Channel(TIMES, WAVE), "b": Channel(late, WAVE), "c": Channel(gone, np.delete(WAVE, [3, 4]))}
    log, notes = FlightLog(tmp_path / "x", "made up", channels), list[str]()
    total = log.signal("a + b - 0.5*c", notes)
    kept = np.delete(np.arange(50), [3, 4, 20])
    np.testing.assert_array_equal(total.times, TIMES[kept])
    np.testing.assert_allclose(total.values, 1.5 * WAVE[kept], rtol=1e-12)
    assert notes == ["a + b - 0.5*c: 3 of 50 rows have a time that not all of its channels have; left out"]
    back = np.concatenate([TIMES[:30], TIMES[10:]])  # a clock that goes back: of equal times the first
    log = FlightLog(tmp_path / "x", "made up", {"a": Channel(back, np.arange(70.0)), "b": Channel(TIMES, WAVE)})
    np.testing.assert_array_equal(log.signal("a + b").times, TIMES)


def test_a_wrong_stamp_of_a_ulog_costs_a_row(tmp_path: Path, flown: bytes) -> None:
    """Of all topics that the default sum adds."""
    at, numbers, rows = 16, dict[str, bytes](), 0
    damaged = bytearray(flown)
    while at < len(flown):
        size, kind = struct.unpack_from("<HB", flown, at)
        body = flown[at + 3 : at + 3 + size]
        if kind == ord("A"):
            numbers[body[3:].decode()] = body[1:3]
        elif kind == ord("D") and body[:2] == numbers["hexjet_control"]:
            rows += 1
            if rows == 100:
                damaged[at + 5] ^= 1  # the lowest byte of its time: 1 us
        at += 3 + size
    log, notes = read(tmp_path / "x.ulg", bytes(damaged)), list[str]()
    assert len(log.signal(signals_of(log, "roll").command, notes).times) == rows - 1 == 199
    assert "1 of 200 rows" in notes[0]


def test_the_channels_as_json_are_one_object(tmp_path: Path, hexjet: Hexjet, flown: bytes) -> None:
    (tmp_path / "x.ulg").write_bytes(flown[:-5])
    done = hexjet("identify", "log", str(tmp_path / "x.ulg"), "--channels", "--json")
    held = json.loads(done.out)
    assert (done.status, held["kind"]) == (0, "ULog")
    assert "cut short" in held["notes"][0]
    told = {channel["name"]: channel for channel in held["channels"]}["vehicle_angular_velocity.xyz[0]"]
    assert (told["values"], round(told["rate_hz"])) == (200, 250)
    listed = hexjet("identify", "log", str(tmp_path / "x.ulg"), "--channels").out.splitlines()
    assert len(listed) == 2 + len(held["channels"])


@pytest.mark.parametrize(
    "before", [b"\xef\xbb\xbf", b"\xff" * 4096, b"HTTP/1.1 200 OK\r\nContent-Type: x\r\n\r\n", bytes(60_000)]
)
@pytest.mark.parametrize("kind", ["ulog", "dataflash", "blackbox"])
@pytest.mark.parametrize("name", ["x.csv", "x.ulg"])
def test_a_log_is_found_behind_what_does_not_belong_to_it(
    tmp_path: Path, flown: bytes, before: bytes, kind: str, name: str
) -> None:
    """Whatever it is called; what stands behind its end does no harm either."""
    whole = {
        "ulog": lambda: flown,
        "blackbox": _blackbox,
        "dataflash": lambda: dataflash(9, "CTUN", "Qf", "TimeUS,PD", ROWS),
    }[kind]()
    plain, found = read(tmp_path / name, whole), read(tmp_path / name, before + whole)
    assert found.kind == plain.kind
    assert found.remarks == (f"{len(before)} bytes before the head of the log are passed over", *plain.remarks)
    for label, channel in plain.channels.items():
        np.testing.assert_array_equal(found.channels[label].values, channel.values)
    behind = read(tmp_path / name, whole + 3 * b"appended ")
    assert set(behind.channels) == set(plain.channels)


ROWS = [(1000 * n, 1.0 * n) for n in range(50)]


def _blackbox() -> bytes:
    count = np.arange(100)
    table = {"loopIteration": count, "time": 10**6 + 500 * count, "gyroADC[0]": count}
    return Writer().head() + b"".join(Writer().frames(table)) + END


@pytest.mark.parametrize("share", [0.7, 0.9])
def test_a_ulog_that_is_cut_says_so(tmp_path: Path, flown: bytes, share: float) -> None:
    assert not read(tmp_path / "x.ulg", flown).remarks
    log = read(tmp_path / "x.ulg", flown[: int(share * len(flown))])
    assert any("cut short" in remark for remark in log.remarks)
    assert 0.5 * share < np.ptp(log.channels["vehicle_angular_velocity.xyz[0]"].times) / 0.8 < share + 0.05


def test_a_ulog_that_is_cut_has_its_columns(tmp_path: Path, flown: bytes) -> None:
    """Wherever it was cut: topics end in different rows then, and a thrust stands with the command that it answers."""
    whole, _ = as_columns(read(tmp_path / "x.ulg", flown))
    for cut in range(len(flown) - 900, len(flown), 180):
        columns, _ = as_columns(read(tmp_path / "y.ulg", flown[:cut]))
        for name in ("throttle_1", "thrust_1_N", "rate_p_measured_rad_s"):
            np.testing.assert_allclose(columns[name][:-2], whole[name][: len(columns) - 2], rtol=1e-9)


def test_a_ulog_that_its_reader_never_ends_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A message of no kind whose size leads behind the end: pyulog goes back by it, and comes to it again, for ever."""
    monkeypatch.setattr(reader, "MAX_CPU_S", 0.5)

    def message(kind: int, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind) + body

    said = [message(ord("I"), b"\x0dchar[100] k%02d" % n + 100 * b"x") for n in range(30)]
    endless = struct.pack("<HB", 1 + 50 + 3 * len(said[0]), 0) + bytes(50)
    (tmp_path / "x.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8) + b"".join(said) + endless)
    with pytest.raises(InputError, match=r"x\.ulg: cannot be read: it is damaged; the process was not done within"):
        reader.read_apart("ulog.read", tmp_path / "x.ulg")


@pytest.mark.parametrize("before", [b"", b"\xff" * 100], ids=["alone", "behind"])
def test_the_byte_by_which_a_ulog_is_damaged_is_told(tmp_path: Path, before: bytes) -> None:
    """A first message of no kind whose size leads behind the end: pyulog goes back by it to before the beginning."""
    log = b"ULog\x01\x12\x35\x01" + bytes(8) + struct.pack("<HB", 60_000, 0) + bytes(50)
    with pytest.raises(InputError, match=r"as ULog: it is damaged at byte (\d+) or before that$") as refused:
        read(tmp_path / "x.ulg", before + log)
    assert str(len(before) + len(log)) in str(refused.value)


@pytest.mark.parametrize("number", ["1e309", "-1e309", "nan", "1e30", "9" * 400, "0xffffffffff", "", "x"])
def test_a_number_of_a_blackbox_head_may_be_anything(tmp_path: Path, number: str) -> None:
    """It is the default then; a huge interval of frames costs no time."""
    count = np.arange(100)
    table = {"loopIteration": count, "time": 10**6 + 500 * count, "gyroADC[0]": count}
    frames = b"".join(Writer().frames(table)) + END
    for name in (b"I interval", b"P interval", b"vbatref", b"motorOutput", b"minthrottle", b"gyro_scale"):
        lines = [b"H " + name + b":" + number.encode() if line.startswith(b"H " + name) else line
                 for line in Writer().head().split(b"\n")]  # fmt: skip
        assert len(read(tmp_path / "x.bbl", b"\n".join(lines) + frames).channels["gyroADC[0]"].values) == 100
    head = Writer().head().replace(b"Data version:2", b"Data version:" + number.encode())
    with pytest.raises(InputError, match="data version 1; allowed: 2"):
        read(tmp_path / "x.bbl", head + frames)


def test_frames_that_are_not_logged_are_counted_at_once(tmp_path: Path) -> None:
    count = np.array([0, 3 * 10**8, 6 * 10**8])
    head = Writer(every=2**31 - 1, of=10**8).head()
    table = {"loopIteration": count, "time": 10**6 + 500 * np.arange(3)}
    frames = b"".join(Writer(every=2**31 - 1, of=10**8).frames(table)) + END
    assert read(tmp_path / "x.bbl", head + frames).channels["gyroADC[0]"].values.size
