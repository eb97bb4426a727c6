"""Files and logs over MAVLink: reading, listing, loss, hostile requests; and a run's ULog as a ground station gets it."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from threading import Event, current_thread
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mavlink_bench import Bench, ReadyStore, Station
from patience import PATIENCE
from pyulog import ULog

from cosim import fly
from cosim.groundstation.mavlink.services.ftp import File, FileService, MemoryFile
from cosim.groundstation.mavlink.services.logs import LogService, LogStore, find_finished_runs
from cosim.groundstation.mavlink.services.service import crc32
from cosim.results.export import export_log
from cosim.spec.scenario import Scenario

TO = (1, 1)
NONE, TERMINATE, RESET, LIST, OPEN, READ, CRC, BURST = 0, 1, 2, 3, 4, 5, 14, 15
ACK, NAK = 128, 129
FAIL, BAD_SIZE, BAD_SESSION, END, UNKNOWN, PROTECTED, NOT_FOUND = 1, 3, 4, 6, 7, 9, 10
DATA = 239
TEXT = bytes(range(256)) * 200  # 51200 bytes: more than two bursts
CONTENT = {"log/a.ulg": TEXT, "log/deep/b.ulg": b"b", "etc/x.json": b"{}", "empty": b""}


def files(path: str = "") -> Mapping[str, File]:
    return {path: MemoryFile(data) for path, data in CONTENT.items()}


class Reply(NamedTuple):
    sequence: int
    session: int
    code: int
    asked: int
    last: bool
    offset: int
    data: bytes


class Client:
    """FTP as a ground station speaks it: a sequence number for each request, the same one when it is repeated."""

    def __init__(self, station: Station, session: int = 0) -> None:
        self.station, self.session = station, session
        self.sequence = 0

    def put(self, code: int, data: bytes = b"", offset: int = 0, size: int | None = None) -> None:
        size = len(data) if size is None else size
        head = struct.pack("<HBBBBBBI", self.sequence, self.session, code, size, 0, 0, 0, offset)
        self.station.send("FILE_TRANSFER_PROTOCOL", 0, *TO, list((head + data).ljust(251, b"\0")))

    def get(self, seconds: float = 0.5) -> Reply | None:
        message = self.station.wait("FILE_TRANSFER_PROTOCOL", seconds=seconds)
        if message is None:
            return None
        assert (message.target_system, message.target_component) == (255, 190)
        raw = bytes(message.payload)
        sequence, session, code, size, asked, last, _, offset = struct.unpack("<HBBBBBBI", raw[:12])
        return Reply(sequence, session, code, asked, bool(last), offset, raw[12 : 12 + size])

    def ask(self, code: int, data: bytes = b"", offset: int = 0, size: int | None = None) -> Reply:
        """One request, repeated with its sequence number until it is answered."""
        for _ in range(20):
            self.put(code, data, offset, size)
            while (reply := self.get()) is not None:
                if reply.asked == code and reply.sequence == (self.sequence + 1) & 0xFFFF:
                    self.sequence = (self.sequence + 2) & 0xFFFF
                    return reply
        raise AssertionError("no answer")

    def burst(self, offset: int) -> list[Reply]:
        """What comes of one burst."""
        for _ in range(20):
            self.put(BURST, offset=offset, size=DATA)
            replies = []
            while (reply := self.get()) is not None:
                if reply.asked == BURST:
                    replies.append(reply)
                    if reply.last or reply.code == NAK:
                        break
            if replies:
                self.sequence = (replies[-1].sequence + 1) & 0xFFFF
                return replies
        raise AssertionError("no answer")

    def download(self, path: str) -> bytes:
        """Open, bursts, what is missing by single reads, close: as QGroundControl and MAVSDK do."""
        opened = self.ask(OPEN, path.encode() + b"\0")
        assert opened.code == ACK
        (size,) = struct.unpack("<I", opened.data)
        parts: dict[int, bytes] = {}
        at = 0
        while at < size:
            for reply in self.burst(at):
                assert reply.session == self.session
                parts[reply.offset] = reply.data
                at = max(at, reply.offset + len(reply.data))
        place = 0
        while place < size:
            if place not in parts:
                reply = self.ask(READ, offset=place, size=DATA)
                assert (reply.code, reply.offset) == (ACK, place)
                parts[place] = reply.data
            place += len(parts[place])
        assert self.ask(TERMINATE).code == ACK
        return b"".join(parts[place] for place in sorted(parts))


def client(session: int = 0, **link: Any) -> Client:
    return Client(Bench(FileService(files), **link).station(), session)


@pytest.fixture
def ftp() -> Client:
    return client()


@pytest.fixture
def opened(ftp: Client) -> Client:
    """A client that has opened the long file."""
    ftp.ask(OPEN, b"log/a.ulg\0")
    return ftp


@pytest.mark.parametrize("path", ["log/a.ulg", "/log/a.ulg", "@MAV_LOG/a.ulg", "/@MAV_LOG//a.ulg", "./log/./a.ulg"])
def test_a_file_is_what_it_is(path: str) -> None:
    assert client(session=7).download(path) == TEXT


@pytest.mark.parametrize("seed", range(5))
def test_a_file_with_a_fifth_of_the_frames_lost(seed: int) -> None:
    assert client(loss=0.2, seed=seed).download("log/a.ulg") == TEXT


def test_bursts_are_bounded_paced_numbered_and_say_which_is_their_last(opened: Client) -> None:
    first = opened.sequence
    replies = opened.burst(0)
    assert len(replies) == 100
    assert [reply.last for reply in replies] == [False] * (100 - 1) + [True]
    assert [reply.sequence for reply in replies] == list(range(first + 1, first + 1 + 100))
    assert [reply.offset for reply in replies] == [DATA * i for i in range(100)]
    opened.put(BURST, size=DATA)
    opened.station.bench.tick()
    assert len(opened.station.inbox) == 16
    rest = opened.burst(len(TEXT) - 100)
    assert (rest[-1].last, rest[-1].data) == (True, TEXT[-100:])


def test_the_end_of_a_file_is_refused_politely(ftp: Client) -> None:
    ftp.ask(OPEN, b"log/deep/b.ulg\0")
    assert ftp.ask(READ, offset=0, size=DATA).data == b"b"
    for code, offset in ((READ, 1), (BURST, 1), (READ, 2**32 - 1)):
        reply = ftp.ask(code, offset=offset, size=DATA)
        assert (reply.code, reply.data) == (NAK, bytes([END]))
    assert struct.unpack("<I", ftp.ask(OPEN, b"empty\0").data) == (0,)
    assert ftp.ask(READ, offset=0, size=DATA).data == bytes([END])


def test_a_small_read_is_small(opened: Client) -> None:
    assert opened.ask(READ, offset=5, size=3).data == TEXT[5:8]
    opened.put(BURST, offset=0, size=80)
    reply = opened.get()
    assert len(reply.data) == 80


def test_a_file_that_is_not_there_is_refused_with_the_session_that_was_said() -> None:
    """MAVProxy asks for @PARAM/param.pck under a session of its own and waits ten seconds for that number."""
    ftp = client(session=42)
    for path in (b"@PARAM/param.pck\0", b"log\0", b"\0", b"", b"log/a.ulg/\xff\0"):
        reply = ftp.ask(OPEN, path)
        assert (reply.code, reply.data, reply.session) == (NAK, bytes([NOT_FOUND]), 42)


@pytest.mark.parametrize(
    "path",
    [b"../etc/passwd", b"/../../../etc/passwd", b"log/../../x", b"/etc/passwd", b"log/..", b"\xff\xfe", b"%2e%2e/x", b"x" * 239, b"/" * 239],
)  # fmt: skip
def test_no_ftp_path_leads_out_of_the_folder(ftp: Client, path: bytes) -> None:
    assert ftp.ask(OPEN, path).data == bytes([NOT_FOUND])
    assert ftp.ask(CRC, path).data == bytes([NOT_FOUND])
    reply = ftp.ask(LIST, path)
    assert reply.code == NAK or path == b"/" * 239


def test_a_folder_is_listed_in_parts() -> None:
    many = {f"log/{number:03d}-{'x' * 40}.ulg": b"12345" for number in range(50)}
    ftp = Client(Bench(FileService(lambda path: {path: MemoryFile(data) for path, data in many.items()})).station())
    found: list[bytes] = []
    while (reply := ftp.ask(LIST, b"/log\0", offset=len(found))).code == ACK:
        assert len(reply.data) <= DATA
        found += reply.data.split(b"\0")[:-1]
    assert reply.data == bytes([END])
    assert found == [f"F{path.removeprefix('log/')}\t5".encode() for path in many]


def test_folders_are_told_from_files_and_files_have_a_checksum(ftp: Client) -> None:
    assert ftp.ask(LIST, b"/\0").data == b"Fempty\t0\0Detc\0Dlog\0"
    assert ftp.ask(LIST, b"@MAV_LOG\0").data == b"Fa.ulg\t51200\0Ddeep\0"
    assert ftp.ask(LIST, b"nowhere\0").data == bytes([NOT_FOUND])
    assert struct.unpack("<I", ftp.ask(CRC, b"log/a.ulg\0").data) == (crc32(TEXT),)
    assert struct.unpack("<I", ftp.ask(CRC, b"empty\0").data) == (0,)
    assert not ftp.station.bench.services[0].is_busy


def test_nothing_can_be_written(ftp: Client) -> None:
    for code in range(6, 14):
        reply = ftp.ask(code, b"log/a.ulg\0")
        assert (reply.code, reply.data) == (NAK, bytes([PROTECTED]))
    for code in (16, 17, 100, 127, ACK, NAK, 255):
        reply = ftp.ask(code, b"x\0")
        assert (reply.code, reply.data) == (NAK, bytes([UNKNOWN]))
    assert ftp.ask(NONE).code == ACK


def test_sessions_are_the_clients_own() -> None:
    """Two files of one client, and another client with the same number."""
    bench = Bench(FileService(files))
    first, second = bench.station(), bench.station(255, 190)
    one, two, other = Client(first, 1), Client(first, 2), Client(second, 1)
    one.ask(OPEN, b"log/a.ulg\0")
    two.ask(OPEN, b"log/deep/b.ulg\0")
    other.ask(OPEN, b"etc/x.json\0")
    assert one.ask(READ, size=4).data == TEXT[:4]
    assert two.ask(READ, size=4).data == b"b"
    assert other.ask(READ, size=4).data == b"{}"
    assert one.ask(TERMINATE).code == one.ask(TERMINATE).code == ACK  # the first answer may have been lost
    assert one.ask(READ, size=4).data == bytes([BAD_SESSION])
    assert two.ask(RESET).code == ACK
    assert two.ask(READ, size=4).data == two.ask(BURST, size=4).data == bytes([BAD_SESSION])
    assert other.ask(READ, size=4).data == b"{}"


def test_sessions_and_clients_are_bounded() -> None:
    service = FileService(files)
    bench = Bench(service)
    station = bench.station()
    for session in range(256):
        Client(station, session).ask(OPEN, b"log/a.ulg\0")
    for component in range(100):
        bench.station(9, component).send(
            "FILE_TRANSFER_PROTOCOL", 0, *TO, [0, 0, 0, OPEN, 6, 0, 0, 0, 0, 0, 0, 0, *b"empty\0"] + [0] * 233
        )
    assert len(service._clients) == 16
    assert all(len(state.open) <= 8 for state in service._clients.values())
    service.forget(bench.stations[99].peer)
    assert len(service._clients) == 15


def test_opening_again_costs_no_other_session(ftp: Client) -> None:
    for session in (*range(8), 7):
        Client(ftp.station, session).ask(OPEN, b"etc/x.json\0")
    assert Client(ftp.station, 1).ask(READ, size=4).data == b"{}"
    assert ftp.download("log/a.ulg") == TEXT  # a session that was left open is opened again


def test_a_burst_ends_with_its_session(opened: Client) -> None:
    opened.put(BURST, size=DATA)
    opened.station.bench.tick()
    opened.put(TERMINATE)
    opened.station.take()
    opened.station.bench.tick(1.0)
    assert not opened.station.take()


def test_a_file_that_is_too_large_for_the_protocol_is_refused() -> None:
    class Huge:
        size = 1 << 32

        def read(self, offset: int, length: int) -> bytes:
            raise AssertionError

    ftp = Client(Bench(FileService(lambda path: {"huge": Huge()})).station())
    assert ftp.ask(OPEN, b"huge\0").data == bytes([FAIL])


@given(st.lists(st.binary(min_size=251, max_size=251), max_size=5))
def test_any_payload_is_answered_or_not_but_never_a_surprise(payloads: list[bytes]) -> None:
    service = FileService(files)
    bench = Bench(service)
    station = bench.station()
    for payload in payloads:
        station.send("FILE_TRANSFER_PROTOCOL", 0, *TO, list(payload))
        bench.tick(0.05)
    for message in station.take():
        assert message.payload[3] in (ACK, NAK)
    assert dict(files()).keys() == CONTENT.keys()


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two finished runs, one that was interrupted before its summary, and one that is broken."""
    root = tmp_path_factory.mktemp("runs")
    for number in (1, 2):
        fly(Scenario.load("hover").replace(duration_s=0.2 * number), out=root / f"run{number}")
    (root / "unfinished").mkdir()
    broken = root / "run3"
    broken.mkdir()
    (broken / "summary.json").write_text('{"started": "2999-01-01T00:00:00Z"}')
    (broken / "flight.parquet").write_text("nonsense")
    return root


@pytest.fixture(scope="module")
def store(runs: Path) -> Iterator[LogStore]:
    with closing(LogStore(lambda: find_finished_runs(runs))) as store:
        yield store


def entries(station: Station) -> dict[int, Any]:
    """The list; what is missing is asked for again, as QGroundControl does."""
    found: dict[int, Any] = {}
    for _ in range(30):
        station.send("LOG_REQUEST_LIST", *TO, 0, 0xFFFF)
        while (entry := patient(station)) is not None:
            found[entry.id] = entry
            if len(found) >= entry.num_logs:
                return found
    raise AssertionError("no list")


def patient(station: Station) -> Any:
    """An entry: the other process works in real time, and the clock of the bench does not."""

    deadline = time.monotonic() + PATIENCE
    while station.bench.services[0].is_busy and time.monotonic() < deadline:
        entry = station.wait("LOG_ENTRY", seconds=0.0)
        if entry is not None:
            return entry
        time.sleep(0.01)
    return station.wait("LOG_ENTRY", seconds=0.1)


def download(station: Station, number: int, size: int, chunk: int = 512 * 90) -> bytes:
    """As MAVSDK: chunk by chunk, of each what is still missing."""
    parts: dict[int, bytes] = {}
    for start in range(0, size, chunk):
        end = min(size, start + chunk)
        for _ in range(1000):
            missing = [at for at in range(start, end, 90) if at not in parts]
            if not missing:
                break
            first = missing[0]
            last = next((at for at in range(first, end, 90) if at in parts), end)
            station.send("LOG_REQUEST_DATA", *TO, number, first, last - first)
            while (part := station.wait("LOG_DATA", seconds=0.1)) is not None:
                assert part.id == number
                parts[part.ofs] = bytes(part.data[: part.count])
                if part.ofs + part.count >= last:
                    break
    return b"".join(parts[at] for at in sorted(parts))


@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_a_run_is_listed_and_got_as_the_ulog_of_export(
    runs: Path, store: LogStore, tmp_path: Path, loss: float
) -> None:
    station = Bench(LogService(store), loss=loss).station()
    found = entries(station)
    assert sorted(found) == [0, 1, 2]
    assert {entry.last_log_num for entry in found.values()} == {2}
    assert found[2].size == 0  # the broken one; MAVSDK refuses to download it
    for number in (0, 1):
        expected = tmp_path / f"{number}.ulg"
        export_log("ulog", runs / f"run{number + 1}", expected, rates="px4")
        assert found[number].size == expected.stat().st_size
        got = download(station, number, found[number].size)
        assert got == expected.read_bytes()
        copy = tmp_path / "copy.ulg"
        copy.write_bytes(got)
        log = ULog(str(copy))
        assert log.get_dataset("vehicle_attitude").data["timestamp"][-1] == pytest.approx(2e5 * (number + 1), abs=4001)
        assert found[number].time_utc > 1.6e9


def test_logs_are_listed_and_downloaded_by_ftp(runs: Path, store: LogStore) -> None:
    bench = Bench(LogService(store), FileService(lambda path: store.files()))
    station = bench.station()
    size = entries(station)[0].size
    ftp = Client(station)
    names = [line.split(b"\t")[0][1:].decode() for line in ftp.ask(LIST, b"@MAV_LOG\0").data.split(b"\0")[:-1]]
    assert len(names) == 2
    assert names[0].startswith("log_0_20")
    data = ftp.download(f"log/{names[0]}")
    assert len(data) == size
    assert data[:4] == b"ULog"


def test_no_runs_is_a_list_of_none(tmp_path: Path) -> None:
    with closing(LogStore(lambda: find_finished_runs(tmp_path / "nowhere"))) as store:
        station = Bench(LogService(store)).station()
        station.send("LOG_REQUEST_LIST", *TO, 0, 0xFFFF)
        entry = patient(station)
        assert (entry.id, entry.num_logs, entry.size) == (0, 0, 0)


def ready(tmp_path: Path, size: int) -> ReadyStore:
    """A store of one log that is there, of so many bytes."""
    path = tmp_path / "0.ulg"
    path.write_bytes(bytes(i * 7 % 251 for i in range(size)))
    return ReadyStore(path)


@pytest.mark.parametrize("size", [1, 89, 90, 91, 180, 900, 46080, 50_000])
def test_a_log_that_is_asked_for_without_an_end_has_one(tmp_path: Path, size: int) -> None:
    """MAVProxy asks for 4 GiB and stops at a part that is not full."""
    store = ready(tmp_path, size)
    station = Bench(LogService(store)).station()
    station.send("LOG_REQUEST_DATA", *TO, 0, 0, 0xFFFFFFFF)
    station.bench.tick(2.0)
    parts = station.take("LOG_DATA")
    assert b"".join(bytes(p.data[: p.count]) for p in parts) == (tmp_path / "0.ulg").read_bytes()
    assert parts[-1].count == 0
    assert [p.count for p in parts[:-2]] == [90] * (math.ceil(size / 90) - 1)
    assert not station.bench.services[0].is_busy


def test_only_what_is_asked_for_is_sent_and_an_end_ends_it(tmp_path: Path) -> None:
    station = Bench(LogService(ready(tmp_path, 50_000))).station()
    station.send("LOG_REQUEST_DATA", *TO, 0, 900, 180)
    station.bench.tick(0.1)
    assert [(p.ofs, p.count) for p in station.take("LOG_DATA")] == [(900, 90), (990, 90)]
    station.send("LOG_REQUEST_DATA", *TO, 0, 0, 50_000)
    station.bench.tick()
    assert 0 < len(station.take("LOG_DATA")) <= 30  # not all at once
    station.send("LOG_REQUEST_END", *TO)
    station.bench.tick(1.0)
    assert not station.take("LOG_DATA")


@pytest.mark.parametrize(
    ("number", "offset", "count", "answers"),
    [
        (5, 0, 90, 0),
        (65535, 0, 90, 0),
        (0, 1000, 90, 1),
        (0, 2**32 - 1, 2**32 - 1, 1),
        (0, 0, 0, 1),
        (0, 999, 2**32 - 1, 2),
    ],
)
def test_parts_that_are_not_there_are_empty(tmp_path: Path, number: int, offset: int, count: int, answers: int) -> None:
    station = Bench(LogService(ready(tmp_path, 1000))).station()
    station.send("LOG_REQUEST_DATA", *TO, number, offset, count)
    station.bench.tick(0.1)
    parts = station.take("LOG_DATA")
    assert len(parts) == answers
    assert all(part.count == 0 for part in parts[-1:])


def test_a_log_that_vanishes_ends(tmp_path: Path) -> None:
    station = Bench(LogService(ready(tmp_path, 50_000))).station()
    (tmp_path / "0.ulg").unlink()
    station.send("LOG_REQUEST_DATA", *TO, 0, 0, 50_000)
    station.bench.tick(0.1)
    assert [part.count for part in station.take("LOG_DATA")] == [0]


def test_erase_erases_nothing_and_requests_are_bounded(tmp_path: Path) -> None:
    service = LogService(ready(tmp_path, 50_000))
    bench = Bench(service)
    for component in range(100):
        station = bench.station(9, component)
        station.send("LOG_ERASE", *TO)
        station.send("LOG_REQUEST_DATA", *TO, 0, 0, 2**32 - 1)
    assert len(service._downloads) == 16
    assert (tmp_path / "0.ulg").exists()
    service.forget(bench.stations[99].peer)
    assert len(service._downloads) == 15


def search(store: LogStore, now: float) -> None:
    """Let it look for runs, and wait until it has."""
    store.search(now)
    while store.is_searching:
        store._add_found_runs(now)


def test_lists_that_are_asked_for_again_and_again_read_no_files_and_hold_up_nobody(tmp_path: Path) -> None:
    """The folders are read in another thread, once in a while; who asks meanwhile gets the list when it is there."""
    reads, go_on = [], Event()

    def slow() -> list[Path]:
        reads.append(current_thread().name)
        go_on.wait(PATIENCE)
        return []

    with closing(LogStore(slow)) as store:
        station = Bench(LogService(store)).station()
        for _ in range(50):
            station.send("LOG_REQUEST_LIST", *TO, 0, 0xFFFF)
            station.bench.tick(0.02)
        assert not station.inbox
        go_on.set()
        assert patient(station).num_logs == 0
        for _ in range(50):
            station.send("LOG_REQUEST_LIST", *TO, 0, 0xFFFF)
            station.bench.tick(0.02)
        assert reads == ["logs"]
        assert len(station.take("LOG_ENTRY")) == 50


@pytest.mark.parametrize("during", [False, True])
def test_a_run_that_has_just_been_finished_is_in_the_next_list(tmp_path: Path, during: bool) -> None:
    """Also where the folders were read a moment before, or are just being read: its flight was the last thing done."""
    here: list[Path] = []
    begun, go_on = Event(), Event()

    def found() -> list[Path]:
        now = list(here)
        begun.set()
        go_on.wait(PATIENCE)
        return now

    with closing(LogStore(found)) as store:
        store.search(0.0)
        assert begun.wait(PATIENCE)
        if not during:
            go_on.set()
            search(store, 0.0)
        here.append(tmp_path / "run")
        store.mark_outdated()
        go_on.set()
        search(store, 0.1)
        assert [log.run.name for log in store.logs] == ["run"]


def test_of_many_runs_the_newest_are_kept_and_numbers_stay(tmp_path: Path) -> None:
    here: list[Path] = [tmp_path / f"run{number}" for number in range(20 + 5)]
    with closing(LogStore(lambda: here)) as store:
        search(store, 0.0)
        assert [log.run.name for log in store.logs] == [f"run{number}" for number in range(5, 20 + 5)]
        here.append(tmp_path / "later")
        search(store, 1.0)  # too soon
        assert len(store.logs) == 20
        search(store, 10.0)  # and not too soon
        search(store, 20.0)
        assert [log.number for log in store.logs] == list(range(20 + 1))
        assert store.logs[-1].run.name == "later"
