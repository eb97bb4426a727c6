"""The local page: who may read and command, what it is told, and a flight by hand in a real browser."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any

import pytest
from patience import PATIENCE
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from cosim.base.errors import InputError
from cosim.base.frames import to_euler
from cosim.base.protocols import EngineState
from cosim.control.autopilot.modes import LandedState, Mode
from cosim.control.autopilot.requests import SetParameter
from cosim.groundstation import read_only
from cosim.groundstation.exchange import Exchange, Snapshot
from cosim.groundstation.session import RecordOptions, Session
from cosim.groundstation.session_flight import make_flight_info
from cosim.groundstation.web import feed, server
from cosim.groundstation.web.server import WebServer
from cosim.results.report.page import ASSETS
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario

STATIC = Path(server.__file__).parent / "static"
VENDOR = ASSETS / "vendor"
SOON = PATIENCE  # for what takes milliseconds


class Flown:
    """A session that flies in a thread of its own, with its page."""

    def __init__(self, folder: Path, factor: float) -> None:
        self.exchange = Exchange()
        scenario = Scenario.load("hover").replace(name="gcs", engine="edf-as-flown", controller="smith")
        self.session = Session(scenario, self.exchange, factor=factor, records=RecordOptions(folder, report=False))
        self.folder = folder
        self.web = WebServer(self.exchange, 0)
        self.thread = threading.Thread(target=self.session.run)

    def __enter__(self) -> Flown:
        self.web.start()
        self.thread.start()
        until(lambda: self.exchange.snapshot is not None and self.exchange.snapshot.sample is not None)
        return self

    def __exit__(self, *_: object) -> None:
        self.session.stop("the test is over")
        self.thread.join()
        self.web.stop()

    @property
    def now(self) -> Snapshot:
        assert self.exchange.snapshot is not None
        return self.exchange.snapshot

    @property
    def token(self) -> str:
        """Of the printed address."""
        return self.web.url.partition("?token=")[2]

    @property
    def home(self) -> str:
        """The path of the page, as printed."""
        return f"/?token={self.token}"

    @property
    def files(self) -> str:
        """What the paths of its files begin with, as the page has it."""
        found = re.search(r'src="(/[^"/]+)/main.js"', self.get(self.home).read().decode())
        assert found
        return found[1]

    def get(self, path: str, *hosts: str) -> HTTPResponse:
        client = HTTPConnection("127.0.0.1", self.web.port, timeout=SOON)
        client.putrequest("GET", path, skip_host=True)
        for host in hosts or (f"127.0.0.1:{self.web.port}",):
            client.putheader("Host", host)
        client.endheaders()
        return client.getresponse()

    def dial(self, origin: str | None = "", **more: Any) -> contextlib.AbstractContextManager[ClientConnection]:
        origin = f"http://127.0.0.1:{self.web.port}" if origin == "" else origin
        url = f"ws://127.0.0.1:{self.web.port}/live"
        return connect(url, origin=origin, proxy=None, compression=None, close_timeout=0.5, **more)  # type: ignore[arg-type]

    @contextlib.contextmanager
    def page(self) -> Iterator[Page]:
        with self.dial() as link:
            link.send(json.dumps({"token": self.token}))
            yield Page(link)


class Page:
    """What the page does, without the page."""

    def __init__(self, link: ClientConnection) -> None:
        self.link = link
        self.number = 0
        self.last: dict[str, Any] = {}  # of each kind

    def next(self, kind: str) -> dict[str, Any]:
        """The next message of a kind."""
        for _ in range(1000):
            told: dict[str, Any] = json.loads(self.link.recv(SOON))
            self.last[told["type"]] = told
            if told["type"] == kind:
                return told
        raise AssertionError(f"no {kind}")

    def flood(self) -> None:
        """Ask as fast as it goes, and do not listen."""
        for number in range(200_000):
            self.link.send(f'{{"id": {number}, "request": "Hold"}}')

    def ask(self, request: str, **fields: Any) -> dict[str, Any]:
        self.number += 1
        self.link.send(json.dumps({"id": self.number, "request": request, **fields}))
        answer = self.next("answer")
        assert answer.pop("id") == self.number
        return answer


def until(true: Callable[[], bool], seconds: float = SOON) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


@contextlib.contextmanager
def closed(code: int) -> Iterator[None]:
    """The link ends, for this reason."""
    with pytest.raises(ConnectionClosed) as ended:
        yield
    assert ended.value.rcvd is not None
    assert ended.value.rcvd.code == code


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flown]:
    """A vehicle on the ground, in real time."""
    with Flown(tmp_path_factory.mktemp("web") / "run", 1.0) as flight:
        yield flight


# --- the files ---------------------------------------------------------------------------------------------------


def test_the_page_is_served_with_everything_it_names(flown: Flown) -> None:
    answer = flown.get(flown.home)
    assert answer.status == 200
    named = [path.removeprefix(flown.files) for path in re.findall(r'(?:src|href)="([^"]+)"', answer.read().decode())]
    assert {"/main.js", "/page.css", "/assets/scene.js", "/assets/vendor/uPlot.iife.min.js"} <= set(named)
    for script in STATIC.glob("*.js"):
        named += [f"/{each}" for each in re.findall(r'from "\./([^"]+)"', script.read_text(encoding="utf-8"))]
    for path in named:
        found = flown.get(flown.files + path)
        assert found.status == 200, path
        there = ASSETS / path.removeprefix("/assets/") if path.startswith("/assets/") else STATIC / path[1:]
        assert found.read() == there.read_bytes()


def test_nothing_comes_from_elsewhere_and_nothing_is_inline(flown: Flown) -> None:
    policy = flown.get(flown.home).headers["Content-Security-Policy"]
    rules = {rule.split()[0]: rule.split()[1:] for rule in policy.split(";")}
    assert rules["default-src"] == ["'none'"]
    assert rules["script-src"] == rules["style-src"] == ["'self'"]
    assert rules["frame-ancestors"] == ["'none'"]
    assert "unsafe" not in policy
    there = [*STATIC.rglob("*"), *VENDOR.glob("uPlot*"), ASSETS / "scene.js"]
    for path in (each for each in there if each.suffix in (".html", ".js", ".css")):
        text = path.read_text(encoding="utf-8")
        for name in ("http://www.w3.org/2000/svg", "https://github.com/leeoniya/uPlot (v"):  # a name space, a comment
            text = text.replace(name, "")
        assert not re.search(r"https?://|url\((?!#)", text), path
    page = (STATIC / "index.html").read_text(encoding="utf-8")
    assert not re.search(r"<style|\sstyle=|\son\w+=|<script(?![^>]*\ssrc=)", page)


@pytest.mark.parametrize(
    "path",
    [
        "/index.html",
        "/../server.py",
        "/assets/../../page.py",
        "/%2e%2e/server.py",
        "/assets/vendor",
        "//",
        "/assets/vendor/README.md",
        "/assets/replay.js",
    ],
)
def test_there_are_no_other_files(flown: Flown, path: str) -> None:
    assert flown.get(flown.files + path).status == 404


def test_the_parts_of_others_are_as_stated() -> None:
    stated = (VENDOR / "README.md").read_text(encoding="utf-8")
    sums = {name: hexes for hexes, name in re.findall(r"^([0-9a-f]{64})  (\S+)$", stated, re.M)}
    shipped = [path for path in VENDOR.iterdir() if path.suffix in (".js", ".css")]
    assert {path.name for path in shipped} == {name for name in sums if not name.endswith(".tgz")}
    for path in shipped:
        assert hashlib.sha256(path.read_bytes()).hexdigest() == sums[path.name]


# --- who may -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "NONSENSE"])
def test_only_get_is_answered_with_a_page(flown: Flown, method: str) -> None:
    port = flown.web.port
    with socket.create_connection(("127.0.0.1", port)) as asking:
        asking.settimeout(SOON)
        asking.sendall(f"{method} / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n".encode())
        answer = b""
        while part := asking.recv(4096):
            answer += part
    head = answer.split(b"\r\n\r\n")[0]
    assert head.startswith(b"HTTP/1.1 405 "), head
    assert b"\r\nAllow: GET" in head
    assert b"token" not in answer


@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=guessed", "/main.js", "/guessed/main.js", "/index.html"])
def test_without_the_printed_address_there_is_nothing(flown: Flown, path: str) -> None:
    """Another account of the machine reaches the port as well as this one; the files' key is no token."""
    for each in (path, f"/?token={flown.files.removeprefix('/')}"):
        answer = flown.get(each)
        assert answer.status == 403
        assert answer.read().startswith(b"Open the address that hexjet has printed")


def test_another_name_for_this_machine_is_refused(flown: Flown) -> None:
    """A foreign name that resolves to the loopback makes a foreign page of the same origin: no page, no token."""
    port = flown.web.port
    here, evil = f"127.0.0.1:{port}", f"evil.example:{port}"
    for hosts in ([evil], ["127.0.0.1"], [f"127.0.0.1:{port + 1}"], [""], [here, here], [f"{here}.evil.example"]):
        answer = flown.get(flown.home, *hosts)
        assert answer.status in (400, 421), hosts
        assert b"token" not in answer.read()
    assert flown.get(flown.home, f"localhost:{port}").status == 200
    with pytest.raises(InvalidStatus) as refused, flown.dial(additional_headers={"Host": evil}):
        pass
    assert refused.value.response.status_code in (400, 421)


def test_a_foreign_origin_is_refused(flown: Flown) -> None:
    port = flown.web.port
    foreign = (
        None, "null", "http://evil.example", f"http://evil.example:{port}", f"http://127.0.0.1:{port + 1}",
        f"https://127.0.0.1:{port}", "http://127.0.0.1",
    )  # fmt: skip
    for origin in foreign:
        with pytest.raises(InvalidStatus) as refused, flown.dial(origin):
            pass
        assert refused.value.response.status_code == 403, origin
    with flown.dial(f"http://localhost:{port}"):
        pass


@pytest.mark.parametrize(
    "hello",
    [
        '{"token": "guessed"}',
        "{}",
        "no json",
        '{"token": 1}',
        '{"token": "\\ud800"}',
        '{"id": 1, "request": "Arm"}',
        b"\0",
    ],
)
def test_without_the_token_nothing_is_told_and_nothing_done(flown: Flown, hello: str | bytes) -> None:
    before = flown.web.refused
    with flown.dial() as link:
        link.send(hello)
        with closed(server.WRONG_TOKEN):
            link.recv(SOON)
    assert flown.web.refused == before + 1
    assert not flown.now.status.armed


def test_who_says_nothing_is_let_go(flown: Flown, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "LIMITS", server.LIMITS._replace(hello_s=0.1))
    with flown.dial() as link, pytest.raises(ConnectionClosed):
        link.recv(SOON)


def test_every_server_has_its_own_token(flown: Flown) -> None:
    with WebServer(Exchange(), 0) as other:
        assert other._token != flown.token
        assert len(other._token) >= 32


def test_it_listens_on_this_machine_alone(flown: Flown) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("192.0.2.1", 9))  # sends nothing; says which address leads out
        outside = probe.getsockname()[0]
    if outside.startswith("127."):
        pytest.skip("this machine has no other address")
    with pytest.raises(OSError, match=r"refused|timed out"):
        socket.create_connection((outside, flown.web.port), 2.0)


def test_a_port_that_is_taken(flown: Flown) -> None:
    with pytest.raises(InputError, match=f"web {flown.web.port}: the port cannot be opened: [^\n]+$"):
        WebServer(Exchange(), flown.web.port).start()
    with pytest.raises(InputError, match="from 0 to 65535"):
        WebServer(Exchange(), 65536)


# --- what it is told ---------------------------------------------------------------------------------------------


def test_the_state_that_is_told(flown: Flown) -> None:
    snapshot = flown.now
    sample, info, seen = snapshot.sample, snapshot.info, snapshot.status.seen
    assert sample is not None
    assert seen is not None
    thrust = tuple(7.0 + jet for jet in range(6))
    sample = sample._replace(engines=sample.engines._replace(thrust=thrust))
    told = json.loads(server._to_json(feed.describe_state(snapshot._replace(sample=sample))))
    assert told["t"] == pytest.approx(snapshot.k * 0.004, abs=5e-4)
    assert told["mode"] == snapshot.status.mode.value
    assert (told["height"], told["velocity"][2]) == (round(seen.altitude, 4), round(seen.velocity[2], 4))
    assert told["attitude_deg"] == [round(math.degrees(a), 4) for a in to_euler(seen.attitude)]
    # nobody armed it, and this engine does not say its speed or its fuel
    said = [(jet["throttle"], jet["asked_N"], jet["thrust_N"], jet["rpm"], jet["fuel_g_s"]) for jet in told["jets"]]
    assert said == [(0.0, 0.0, thrust[jet], None, None) for jet in range(6)]
    throttle = sample.actuation.throttle
    armed = [(jet["throttle"], jet["asked_N"]) for jet in feed.describe_jets(info, sample, off=False)]
    assert armed == [(round(u, 4), round(at.thrust_at(u), 4)) for u, at in zip(throttle, info.stations, strict=True)]
    engines = sample.engines._replace(spool_speed=(100.0 * math.pi,) * 6, exhaust_temperature=(873.15,) * 6)
    (first, *_) = feed.describe_jets(info, sample._replace(engines=engines), off=False)
    assert (first["rpm"], first["exhaust_C"]) == (3000.0, 600.0)


def test_the_strip_chart_gets_measured_and_predicted(flown: Flown) -> None:
    sample = flown.now.sample
    assert sample is not None
    control = sample.control._replace(rate_predicted=(math.nan, math.pi, 0.0))
    measured = [round(math.degrees(rate), 2) for rate in sample.measured.rate]
    point = feed.make_chart_point(sample._replace(control=control))
    assert list(point) == [round(sample.time, 3), *measured, None, 180.0, 0.0]


def test_a_page_is_told_the_flight_then_its_state_in_order(flown: Flown) -> None:
    with flown.page() as page:
        begun = page.next("flight")
        assert (begun["vehicle"], begun["controller"]) == ("hexjet", "smith")
        assert begun["engines"][0]["most_N"] == pytest.approx(flown.now.info.stations[0].curve.thrust[-1], abs=1e-4)
        states = [page.next("state") for _ in range(21)]
    assert states[-1]["t"] > states[0]["t"]
    times = [point[0] for state in states for point in state["strip"]]
    assert times == sorted(set(times))
    # 21 frames, each with at most so many points; a flight at real time is published every step or two
    assert 20 < len(times) <= 21 * server.LIMITS.max_points


def test_the_rows_that_are_told_are_the_log_s(flown: Flown) -> None:
    sample, info = flown.now.sample, flown.now.info
    assert sample is not None
    sample = sample._replace(spool_moment=(math.nan, 1.23456789, 0.0))
    told, rows = feed.describe_flight(info), feed.RowConverter()
    names = [column[0] for column in told["columns"]]
    assert rows(info, None) == []
    rows(info, sample._replace(time=1.0))
    row = dict(zip(names, rows(info, sample), strict=True))  # the second: each row is its own
    assert row["time_s"] == pytest.approx(sample.time, rel=1e-5)
    assert row["roll_measured_rad"] == pytest.approx(to_euler(sample.measured.attitude)[0], rel=1e-5)
    assert row["throttle_6"] == pytest.approx(sample.actuation.throttle[5], rel=1e-5)
    assert [row[f"spool_moment_{axis}_N_m"] for axis in "xyz"] == [None, 1.23457, 0.0]
    assert [tuple(jet["position"]) for jet in told["shape"]["jets"]] == [jet.position_m for jet in info.vehicle.jets]
    json.dumps([told, feed.describe_parameters(info.parameters)], allow_nan=False)


def test_what_blocks_show_of_their_own_is_told_too(tmp_path: Path) -> None:
    """A mapping file's further output, a law's own numbers: they come last, as in the log."""
    with build(Scenario.load("jetwing-cruise")) as simulation:
        info = make_flight_info(simulation, 1, read_only._list_parameters(simulation), tmp_path, 1.0)
        sample = simulation.step()
        shown = [column.name for column in simulation.columns]
        assert shown
        assert [column[0] for column in feed.describe_flight(info)["columns"]][-len(shown) :] == shown
        assert feed.RowConverter()(info, sample)[-len(shown) :] == pytest.approx(sample.own, rel=1e-5)


def test_parameters_are_told_searched_and_set(flown: Flown) -> None:
    with flown.page() as page:
        table = {line["name"]: line for line in page.next("parameters")["table"]}
        values = page.next("values")["values"]
        assert values == flown.now.info.parameters.values
        assert set(table) == set(values)
        assert table["HJ_ALT_P"]["unit"] == "1/s"
        asked = page.ask("SetParameter", name="HJ_ALT_P", value=1e9)
        assert "must be from" in asked["text"]
        asked = page.ask("SetParameter", name="HJ_ALT_P", value=1.25 * values["HJ_ALT_P"])
        assert asked["accepted"]
        assert page.next("values")["values"] == {"HJ_ALT_P": 1.25 * values["HJ_ALT_P"]}  # what has changed, alone
        page.ask("SetParameter", name="HJ_ALT_P", value=values["HJ_ALT_P"])


# --- what it may ask ---------------------------------------------------------------------------------------------


def test_a_page_arms_and_disarms(flown: Flown) -> None:
    with flown.page() as page:
        until(lambda: flown.now.status.ready)
        assert page.ask("Arm") == {"type": "answer", "accepted": True, "result": "accepted", "text": ""}
        until(lambda: flown.now.status.armed)
        assert page.ask("Restart")["text"] == "restart refused: it is armed"
        assert page.ask("Disarm")["accepted"]
        until(lambda: not flown.now.status.armed)
        refused = page.ask("Land")
        assert (refused["accepted"], refused["text"]) == (False, "landing refused: it is on the ground")


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ("{", "message: is not JSON"),
        ("[" * 4000, "message: is not JSON"),
        ("[]", "message: must be a table"),
        (b"{}", "message: must be text"),
        ('{"request": "Takeoff", "altitude_m": NaN}', "NaN"),
        ('{"request": "Takeoff", "altitude_m": "10"}', "must be a number"),
        ('{"request": "Takeoff", "altitude_m": 10, "now": true}', "unknown key 'now'"),
        ('{"request": "Sticks", "roll": 2, "pitch": 0, "yaw": 0, "throttle": 0}', "from -1 to 1"),
        ('{"request": "Arm", "id": "x"}', "whole number"),
        ('{"request": "Shutdown"}', "request = 'Shutdown'"),
        ('{"request": "LinkLost"}', "is not for the page"),
        ('{"request": "SetParameter", "name": "HJ_ALT_P", "value": "1"}', "must be a number"),
        ('{"request": "__init__"}', "request = '__init__'"),
        ("{}", "request = None"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_with_one_line(flown: Flown, message: str | bytes, words: str) -> None:
    before = flown.web.refused
    with flown.page() as page:
        page.link.send(message)
        answer = page.next("answer")
        assert not answer["accepted"]
        assert words in answer["text"]
        assert "\n" not in answer["text"]
        assert flown.web.refused == before + 1
        assert page.ask("Disarm")["text"] == "already disarmed"  # the link is as it was
    assert not flown.now.status.armed


def test_a_message_that_is_too_long_ends_the_link(flown: Flown) -> None:
    with flown.page() as page:
        page.link.send(json.dumps({"request": "Arm", "x": "y" * server.LIMITS.max_message_bytes}))
        with closed(1009):
            page.next("never")
    assert not flown.now.status.armed


def test_a_page_that_floods_is_let_go_and_hurts_nobody(flown: Flown) -> None:
    with flown.page() as quiet, flown.page() as loud:
        quiet.next("state")
        steps = flown.now.k
        with pytest.raises(ConnectionClosed) as ended:
            loud.flood()
        assert ended.value.rcvd is None or ended.value.rcvd.code == server.TOO_MANY
        until(lambda: flown.web.clients == 1)
        assert quiet.ask("Disarm")["accepted"]
        quiet.next("state")
        assert flown.now.k > steps


def test_only_so_many_pages(flown: Flown) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(server.LIMITS.max_pages):
            stack.enter_context(flown.page()).next("flight")
        with flown.page() as late, pytest.raises(ConnectionClosed, match="pages are open already"):
            late.next("flight")
    until(lambda: flown.web.clients == 0)
    with flown.page() as page:
        page.next("state")


def test_a_page_that_does_not_read_misses_frames_and_holds_up_nobody(
    flown: Flown, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "LIMITS", server.LIMITS._replace(frames_1_s=200, stuck_s=1.0))
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.connect(("127.0.0.1", flown.web.port))
    token, skipped = flown.token, flown.web.skipped
    with flown.page() as page, flown.dial(sock=deaf, max_queue=1) as link:
        link.send(json.dumps({"token": token}))
        until(lambda: flown.web.clients == 2)
        behind = next(each for each, known in flown.web._pages.items() if known.number == 2)
        most, seen = 0, 0
        while flown.web.clients == 2:
            # its messages are read, frame by frame, while the other one's wait
            page.next("state")
            seen += 1
            most = max(most, behind.transport.get_write_buffer_size())
            assert seen < 20_000
        assert flown.web.skipped > skipped
        assert behind.protocol.close_sent is None  # let go by us, before the library's pings found out
        assert server.LIMITS.buffer_bytes < most < 3 * server.LIMITS.buffer_bytes
        assert page.ask("Disarm")["accepted"]


def test_the_end_is_told(tmp_path: Path) -> None:
    with Flown(tmp_path / "run", 1.0) as flight, flight.page() as page:
        page.next("state")
        flight.session.stop("enough")
        flight.thread.join()
        while page.next("state")["ending"] is None:
            pass
        for _ in range(3):
            flight.web._on_publish()  # the same step again is nothing to draw
        assert not any(page.next("state")["strip"] for _ in range(20))
        flight.web.stop()
        with closed(1001):
            page.next("never")
        assert page.last["state"]["ending"] == {"outcome": "completed", "reason": "enough"}
        assert flight.web._thread not in threading.enumerate()
        flight.web.stop()


def test_a_new_flight(tmp_path: Path) -> None:
    with Flown(tmp_path / "run", 1.0) as flight, flight.page() as page:
        assert page.next("flight")["number"] == 1
        begin = time.monotonic()
        assert page.ask("Restart")["accepted"]
        assert page.next("flight")["number"] == 2
        state = page.next("state")
        assert state["t"] < 1.0 + time.monotonic() - begin  # a flight in real time is not ahead of the clock
        assert all(point[0] <= state["t"] for point in state["strip"])
        assert flight.now.info.number == 2


# --- in a browser ------------------------------------------------------------------------------------------------


class Screen:
    """The page in a browser."""

    def __init__(self, page: Any) -> None:
        from playwright.sync_api import expect

        self.page = page
        self.expect = expect
        self.errors: list[str] = []
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", lambda said: self.errors.append(said.text) if said.type == "error" else None)

    def shows(self, where: str, what: str, seconds: float = SOON) -> None:
        self.expect(self.page.locator(where)).to_have_text(what, timeout=1e3 * seconds)

    def number(self, where: str) -> float:
        return float(self.page.inner_text(where).replace("−", "-"))

    def middle(self, where: str) -> tuple[float, float]:
        box = self.page.locator(where).bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def requests_of(folder: Path) -> list[dict[str, Any]]:
    """What was asked for by pages, in order."""
    lines = (folder / "requests.jsonl").read_text(encoding="utf-8").splitlines()
    return [line for line in map(json.loads, lines) if line.get("sender", "").startswith("web-")]


@pytest.mark.long
def test_a_flight_by_hand(browser: Any, tmp_path: Path) -> None:
    """Arm, take off, go somewhere, a roll step by stick, land: what the page shows is what the simulation does."""
    with Flown(tmp_path / "run", 2.0) as flight:
        # at twice real time and on a loaded machine half a second of flight is too short for sticks
        flight.exchange.ask(SetParameter("HJ_STICK_TIME", 5.0))
        # and the ten seconds that it stands armed for may be over before a busy browser has shown them
        flight.exchange.ask(SetParameter("HJ_DISARM_IDLE", 0.0))
        flight.exchange.ask(SetParameter("MIS_TAKEOFF_ALT", 7.38462))
        until(lambda: flight.now.info.parameters["MIS_TAKEOFF_ALT"] == 7.38462)
        lean = math.radians(flight.now.info.parameters["HJ_STICK_LEAN"])
        with browser.new_context(viewport={"width": 1280, "height": 800}) as context:
            screen = Screen(page := context.new_page())
            page.goto(flight.web.url)
            # the picture is where the vehicle is, and moves as it does
            until(lambda: float(page.locator("#scene canvas").get_attribute("data-time") or 0.0) > 0.5)
            assert "m high" in page.inner_text(".readout")
            page.click("[data-view=map]")

            page.focus("#tab-flight")
            page.keyboard.press("ArrowRight")
            strips = page.locator("#strips .uplot")
            screen.expect(strips).to_have_count(8, timeout=1e3 * SOON)
            page.fill("#strips-search", "rotor moment x")
            page.keyboard.press("Enter")
            screen.expect(strips).to_have_count(9, timeout=1e3 * SOON)
            page.focus("#tab-strips")
            page.keyboard.press("ArrowRight")
            cells = page.locator("#engine-table tbody tr").nth(5).locator("td")
            screen.expect(cells.nth(9)).to_have_text("100", timeout=1e3 * SOON)
            page.keyboard.press("End")
            page.fill("#parameters-search", "horizontal jerk")
            screen.shows("#parameters-count", f"1 of {len(flight.now.info.parameters.values)}")
            page.fill("#parameters tr:visible input", "2.5")
            page.keyboard.press("Enter")
            until(lambda: flight.now.info.parameters["HJ_JERK_HOR"] == 2.5)
            page.focus("#tab-parameters")
            page.keyboard.press("Home")
            screen.shows("#armed", "ready")
            screen.shows("#title", "hexjet")
            assert float(page.input_value("#takeoff-height")) == 7.4

            page.click("#arm")
            screen.shows("#armed", "armed")
            page.fill("#takeoff-height", "4")
            page.click("#takeoff")
            screen.shows("#landed", "in air", 30.0)
            screen.shows("#mode", "HOLD", 30.0)
            assert screen.number("#height") == pytest.approx(4.0, abs=0.7)
            assert screen.number("#height") == pytest.approx(flight.now.measured.altitude, abs=0.3)

            bars = page.locator(".jet")
            assert bars.count() == 6
            sample, most = flight.now.sample, flight.now.info.stations[0].curve.thrust[-1]
            assert sample is not None
            # both in hundredths of the bar; in a hover neither moves by more than a few
            for jet in range(6):
                given = float(bars.nth(jet).locator(".given").get_attribute("width"))
                asked = float(bars.nth(jet).locator(".asked").get_attribute("x"))
                assert given == pytest.approx(100.0 * sample.thrust[jet] / most, abs=6.0)
                assert asked == pytest.approx(100.0 * sample.actuation.throttle[jet], abs=6.0)

            x, y = screen.middle("#map")
            page.mouse.click(x + 40, y - 30)
            chosen = page.input_value("#goto-north"), page.input_value("#goto-east")
            page.click("#goto-go")
            until(lambda: flight.now.status.target is not None and flight.now.status.target[0] == float(chosen[0]))
            assert flight.now.status.target is not None
            assert flight.now.status.target[1] == float(chosen[1])
            assert float(chosen[0]) > 0.0
            assert float(chosen[1]) > 0.0

            # a place far away is asked about, and one that is no place is said to be none
            page.fill("#goto-north", "99999")
            page.click("#goto-go")
            screen.shows("#confirm-title", "Fly that far?")
            assert "100.0 km" in page.inner_text("#confirm-text")
            page.click("#confirm button[value=no]")
            page.fill("#goto-north", "")
            page.click("#goto-go")
            screen.shows("#answer", "go there: North and East must be numbers, in metres")
            assert flight.now.status.target[0] == float(chosen[0])

            page.click("#kill")
            screen.shows("#confirm-title", "Shut the engines off?")
            page.click("#confirm button[value=no]")
            assert flight.now.status.armed

            # a roll step by stick: full deflection is the full lean
            page.check("#sticks-on")
            until(lambda: flight.now.status.sticks_fresh)
            page.select_option("#mode-choice", "ALTCTL")
            screen.shows("#mode", "ALTCTL")
            x, y = screen.middle("#stick-right")
            page.mouse.move(x, y)
            page.mouse.down()
            page.mouse.move(x + 60, y)
            until(lambda: commanded(flight) == pytest.approx(lean, abs=1e-9))
            until(lambda: to_euler(flight.now.measured.attitude)[0] > 0.7 * lean)
            until(lambda: screen.number("#roll") > 0.7 * math.degrees(lean))
            page.mouse.up()
            until(lambda: commanded(flight) == pytest.approx(0.0, abs=1e-9))
            assert page.inner_text("#rate-measured") != "–"
            assert page.inner_text("#rate-predicted") != "–"
            page.keyboard.down("ArrowLeft")
            until(lambda: commanded(flight) == pytest.approx(-0.5 * lean, abs=1e-9))
            page.keyboard.up("ArrowLeft")
            until(lambda: commanded(flight) == pytest.approx(0.0, abs=1e-9))
            page.click("#hold")
            screen.shows("#mode", "HOLD")
            page.uncheck("#sticks-on")

            page.click("#land")
            screen.shows("#landed", "on ground", 60.0)
            screen.shows("#armed", "ready", 60.0)  # disarmed: the engines are off, and it may be armed again
            assert flight.now.status.engines is EngineState.OFF
            assert flight.now.status.landed is LandedState.ON_GROUND
            assert flight.now.status.mode is Mode.HOLD
            assert "landed" in page.inner_text("#messages")
            kinds, said = (page.locator(f"#events td:nth-child({n})").all_text_contents() for n in (2, 3))
            assert {("mode", "mode HOLD"), ("ground", "in air"), ("ground", "on ground")} <= set(
                zip(kinds, said, strict=True)
            )

            flight.session.stop("enough")
            flight.thread.join()
            flight.web.stop()
            screen.shows("#link", "ended")
            assert page.locator("#arm").is_disabled()
            # after the end the page tries again and again, in vain, and the browser says so
            assert not [error for error in screen.errors if "WebSocket" not in error]
    kinds = [line["request"] for line in requests_of(flight.folder) if line["request"] != "Sticks"]
    assert kinds == ["SetParameter", "Arm", "Takeoff", "Goto", "SetMode", "Hold", "Land"]


def commanded(flight: Flown) -> float:
    """The roll angle that the pilot asks for, rad."""
    assert flight.now.sample is not None
    return flight.now.sample.command.attitude[0]


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_nothing_is_wider_than_the_screen(browser: Any, flown: Flown, width: int, height: int) -> None:
    with browser.new_context(viewport={"width": width, "height": height}) as context:
        screen = Screen(page := context.new_page())
        page.goto(flown.web.url)
        screen.shows("#link", "live")
        until(lambda: page.locator(".jet").count() == 6)
        root = page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
        assert root[0] == width
        if width > 1000:
            assert root[1] == height  # everything in one view
        overflowing = page.evaluate(
            "[...document.querySelectorAll('.card')].filter((c) => c.scrollWidth > c.clientWidth + 1).map((c) => c.id)"
        )
        assert overflowing == []
        # named controls, for those who do not see them
        nameless = page.evaluate(
            "[...document.querySelectorAll('button, input, select')].filter((e) => !e.ariaLabel && !e.labels?.length && !e.textContent.trim()).map((e) => e.id)"
        )
        assert nameless == []
        assert not screen.errors
