"""The server of the local page: a few files and one WebSocket, in a thread of its own, on the loopback alone.

Who may command: a page that this server has given out, to who asked for the printed address with its token.  Every
request must name this server in ``Host``, so that no other name resolved to the loopback gets in; a WebSocket must come
from this server's own origin; and its first message must carry the token, which no foreign page can read.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import os
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from html import escape
from http import HTTPStatus
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qs

from websockets.asyncio.server import ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response
from websockets.typing import Origin

from cosim.base.errors import InputError
from cosim.base.signals import Sample
from cosim.control.autopilot import requests as rq
from cosim.groundstation.exchange import AnswerCallback, Exchange, GroundRequest, Restart, Snapshot, ignore_answer
from cosim.groundstation.web import feed
from cosim.results.report.page import ASSETS, SCENE, THREE, licence_file


class PageLimits(NamedTuple):
    """Limits of the page's server and connections, chosen by us."""

    frames_1_s: int = 20  # frames per second, smooth to the eye
    max_message_bytes: int = 4096  # the page's messages have 200 bytes
    messages_1_s: float = 80.0  # messages/s of one page; sticks send 20
    burst_messages: float = 160.0
    max_pages: int = 8
    # Buffers for a page that reads slowly, here (it then misses frames of 2 kB) and in the kernel, whose default
    # size would hold seconds of old frames.
    buffer_bytes: int = 64 * 1024
    kernel_bytes: int = 32 * 1024
    stuck_s: float = 10.0  # s until a page that never reads is shut
    hello_s: float = 5.0  # s for a page to send its token
    # Most queued points of the strip chart, a second at 16 times real time; and most points in one frame.
    max_waiting_points: int = 4000
    max_points: int = 40
    values_every: int = 10  # frames between parameters: 0.5 s


LIMITS = PageLimits()  # limits of pages and connections
_STATIC = Path(__file__).with_name("static")  # folder of the page's files
_TOKEN, _FILES = "@TOKEN@", "@FILES@"  # placeholders in the page
# Scripts of the report pages that this page uses too.
_REPORT_ASSETS = (
    "vendor/uPlot.iife.min.js", "vendor/uPlot.min.css", THREE, SCENE, licence_file("uPlot"), licence_file("three"),
)  # fmt: skip

# Codes of this server for closing a WebSocket.
WRONG_TOKEN, TOO_MANY = 4401, 4429
TEXT_TYPE = "text/plain; charset=utf-8"  # content type of text files
CONTENT_TYPES = {  # by file ending
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "svg": "image/svg+xml",
}


# Requests that the page may make; missions and faults are left to ground stations.
ALLOWED_REQUESTS = (
    rq.Arm, rq.Disarm, rq.SetMode, rq.Takeoff, rq.Land, rq.ReturnHome, rq.Goto, rq.Hold, rq.SetSpeed, rq.Kill,
    rq.Sticks, rq.SetParameter,
)  # fmt: skip


class WebServer:
    """Server of one session's page; ``port`` 0 selects a free one.

    ``start`` raises InputError where the port is taken.  Everything the flight's thread does here is to leave its last
    sample for the strip chart; frames are made and sent in the server's thread, and a page that is slow misses frames.
    """

    def __init__(self, exchange: Exchange, port: int) -> None:
        if not 0 <= port <= 65535:
            raise InputError(f"web {port}: must be a port from 0 to 65535")
        self._exchange = exchange
        self.port = port
        self.refused = 0  # connections and messages refused
        self.skipped = 0  # frames that slow pages missed
        self._token, self._key = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        self._pages: dict[ServerConnection, _Page] = {}
        self._strip: deque[tuple[int, Sample]] = deque(maxlen=LIMITS.max_waiting_points)
        self._newest_point = (0, -1)  # flight and step of the newest point
        self._rows = feed.RowConverter()
        self._frame_count = 0  # number of frames sent
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        """URL of the page with the token that permits commands."""
        return f"http://127.0.0.1:{self.port}/?token={self._token}"

    @property
    def clients(self) -> int:
        """Number of connected pages that presented the token."""
        return len(self._pages)

    def start(self) -> None:
        """Start serving in a separate thread."""
        try:
            listening = socket.create_server(("127.0.0.1", self.port))
        except OSError as error:
            reason = os.strerror(error.errno or 0)
            raise InputError(f"web {self.port}: the port cannot be opened: {reason}") from error
        # Connections inherit this option from the listening socket.
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, LIMITS.kernel_bytes)
        self.port = listening.getsockname()[1]
        self._hosts = {f"{name}:{self.port}" for name in ("127.0.0.1", "localhost")}
        self._files = _load_files(self._token, self._key, self._hosts)
        running = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run_server(listening, running)), name="web")
        self._thread.daemon = True  # the thread ends with the process
        self._thread.start()
        running.wait()

    def stop(self) -> None:
        """Close all pages and end the server's thread; may be called twice."""
        if self._thread is not None:
            self._call_soon(self._stopping.set)
            self._thread.join()
            self._thread = None

    def __enter__(self) -> WebServer:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    async def _run_server(self, listening: socket.socket, running: threading.Event) -> None:
        self._loop = asyncio.get_running_loop()
        self._stopping = asyncio.Event()
        # Browsers open connections that they may not use, which is not an error.
        quiet = logging.getLogger("cosim.groundstation.web")
        quiet.addHandler(logging.NullHandler())
        quiet.propagate = False
        async with serve(
            self._serve_page,
            sock=listening,
            origins=[Origin(f"http://{host}") for host in self._hosts],
            process_request=self._serve_file,
            compression=None,
            open_timeout=LIMITS.hello_s,
            ping_interval=5,
            ping_timeout=LIMITS.stuck_s,
            close_timeout=1,
            max_size=LIMITS.max_message_bytes,
            max_queue=4,
            server_header=None,
            logger=quiet,
        ):
            unsubscribe = self._exchange.subscribe(self._on_publish)
            frames = asyncio.create_task(self._send_frames())
            running.set()
            await self._stopping.wait()
            unsubscribe()
            frames.cancel()
            self._send_frame()  # pages see how the flight ended

    def _serve_file(self, connection: ServerConnection, request: HttpRequest) -> Response | None:
        """Return a file or a refusal, or None to open a WebSocket, whose origin is checked next."""
        host = request.headers.get_all("Host")
        if len(host) != 1 or host[0].lower() not in self._hosts:
            return self._make_refusal(HTTPStatus.MISDIRECTED_REQUEST, "This is not the server you are looking for.")
        if request.method != "GET":
            refusal = self._make_refusal(HTTPStatus.METHOD_NOT_ALLOWED, "GET only.")
            refusal.headers["Allow"] = "GET"
            return refusal
        path, _, query = request.path.partition("?")
        if path == "/live":
            is_socket = request.headers.get("Upgrade", "").lower() == "websocket"
            return None if is_socket else make_response(HTTPStatus.UPGRADE_REQUIRED, b"A WebSocket.\n")
        key, _, name = path.removeprefix("/").partition("/")
        tokens = parse_qs(query).get("token", []) if path == "/" else []
        if not (any(is_token(token, self._token) for token in tokens) or is_token(key, self._key)):
            text = "Open the address that hexjet has printed, with its token: this page is for those who were told it."
            return self._make_refusal(HTTPStatus.FORBIDDEN, text)
        file = self._files.get(f"/{name}")
        if file is None:
            return make_response(HTTPStatus.NOT_FOUND, b"Not found.\n")
        kind, body, policy = file
        return make_response(HTTPStatus.OK, body, kind, policy)

    def _make_refusal(self, status: HTTPStatus, text: str) -> Response:
        self.refused += 1
        return make_response(status, f"{text}\n".encode())

    async def _serve_page(self, connection: ServerConnection) -> None:
        """Serve one WebSocket until its end."""
        try:
            if not await self._admit(connection):
                return
            numbers = {page.number for page in self._pages.values()}
            page = _Page(next(number for number in range(1, LIMITS.max_pages + 1) if number not in numbers))
            self._pages[connection] = page
            async for text in connection:
                if not page.may_send(time.monotonic()):
                    self.refused += 1
                    await connection.close(TOO_MANY, "too many messages")
                    return
                self._handle_message(connection, page, text)
        except ConnectionClosed:
            pass
        finally:
            self._pages.pop(connection, None)

    async def _admit(self, connection: ServerConnection) -> bool:
        """Return whether a page presented the token and there is room; else close its connection."""
        try:
            async with asyncio.timeout(LIMITS.hello_s):
                hello = _parse_message(await connection.recv())
            token = hello.get("token")
        except (TimeoutError, InputError):
            token = None
        if not is_token(token, self._token):
            self.refused += 1
            await connection.close(WRONG_TOKEN, "wrong token")
            return False
        if len(self._pages) >= LIMITS.max_pages:
            self.refused += 1
            await connection.close(TOO_MANY, f"{LIMITS.max_pages} pages are open already")
            return False
        return True

    def _handle_message(self, connection: ServerConnection, page: _Page, text: str | bytes) -> None:
        """Handle one message of a page, ``{"id": n, "request": ..., ...}``."""
        number: Any = None
        try:
            message = _parse_message(text)
            number = message.pop("id", None)
            if number is not None and (isinstance(number, bool) or not isinstance(number, int)):
                number = None
                raise InputError("id: must be a whole number")
            request = _parse_request(message)
        except InputError as error:
            self.refused += 1
            _send(
                connection, {"type": "answer", "id": number, "accepted": False, "result": "failed", "text": str(error)}
            )
            return
        self._exchange.ask(request, self._make_reply_callback(connection, number), f"web-{page.number}")

    def _make_reply_callback(self, connection: ServerConnection, number: int | None) -> AnswerCallback:
        """Return a callback that sends the answer, or None for sticks, which have no number."""
        if number is None:
            return ignore_answer

        def reply(answer: rq.Answer) -> None:
            result = {"accepted": answer.accepted, "result": answer.result.value, "text": answer.text}
            self._call_soon(lambda: _send(connection, {"type": "answer", "id": number, **result}))

        return reply

    def _call_soon(self, callback: Callable[[], None]) -> None:
        """Schedule a call in the server's thread, if that still runs."""
        with suppress(RuntimeError):  # the event loop has stopped
            self._loop.call_soon_threadsafe(callback)

    def _on_publish(self) -> None:
        """Keep the newest sample for the strip chart; called in the flight's thread."""
        snapshot = self._exchange.snapshot
        if snapshot is None or snapshot.sample is None or not self._pages:
            return
        point = (snapshot.info.number, snapshot.sample.k)
        if point != self._newest_point:  # send each point once
            self._newest_point = point
            self._strip.append((snapshot.info.number, snapshot.sample))

    async def _send_frames(self) -> None:
        while True:
            await asyncio.sleep(1.0 / LIMITS.frames_1_s)
            self._send_frame()

    def _send_frame(self) -> None:
        """Send the present state to each page whose buffer has room."""
        snapshot = self._exchange.snapshot
        if snapshot is None or not self._pages:
            self._strip.clear()
            return
        now, ready = time.monotonic(), []
        for connection, page in list(self._pages.items()):
            if page.is_reading(connection, now):
                ready.append(connection)
            elif now - page.read_at > LIMITS.stuck_s:
                connection.transport.abort()
            else:
                self.skipped += 1
        frame = feed.describe_state(snapshot) | {
            "age_s": round(now - snapshot.published, 2),
            "strip": self._list_new_points(snapshot),
            "row": self._rows(snapshot.info, snapshot.sample),
        }
        self._frame_count += 1
        for connection in ready:
            self._send_updates(connection, self._pages[connection], snapshot)
        broadcast(ready, _to_json(frame))

    def _list_new_points(self, snapshot: Snapshot) -> list[feed.Point]:
        """Return new points of the strip chart, thinned if the flight is too fast."""
        new = []
        while self._strip:
            number, sample = self._strip.popleft()
            if number == snapshot.info.number:
                new.append(sample)
        return [feed.make_chart_point(sample) for sample in new[:: 1 + len(new) // LIMITS.max_points]]

    def _send_updates(self, connection: ServerConnection, page: _Page, snapshot: Snapshot) -> None:
        """Send a page the changes of flight, parameters and messages since the last update."""
        if page.flight != snapshot.info.number:
            page.flight = snapshot.info.number
            page.values = {}
            _send(connection, feed.describe_flight(snapshot.info))
            _send(connection, {"type": "parameters", "table": feed.describe_parameters(snapshot.info.parameters)})
        if not page.values or self._frame_count % LIMITS.values_every == 0:
            values = dict(snapshot.info.parameters.values)
            if changed := {name: value for name, value in values.items() if page.values.get(name) != value}:
                page.values = values
                _send(connection, {"type": "values", "values": changed})
        messages = [message for message in self._exchange.messages if message.number > page.last_message]
        if messages:
            page.last_message = messages[-1].number
            lines = feed.describe_messages(messages, snapshot.info.scenario.step_s)
            _send(connection, {"type": "messages", "lines": lines})


class _Page:
    """State of one open page: what was sent last, and its message budget."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.flight = 0  # number of the flight sent last
        self.last_message = 0  # number of the message sent last
        self.values: dict[str, float] = {}  # parameters sent last
        self.read_at = time.monotonic()
        self._allowance, self._last_count = LIMITS.burst_messages, self.read_at

    def may_send(self, now: float) -> bool:
        """Count one message at ``now`` [s]; return False if there were too many."""
        self._allowance = (
            min(LIMITS.burst_messages, self._allowance + LIMITS.messages_1_s * (now - self._last_count)) - 1.0
        )
        self._last_count = now
        return self._allowance >= 0.0

    def is_reading(self, connection: ServerConnection, now: float) -> bool:
        """Return whether the page's buffer has room for another frame."""
        if connection.transport.get_write_buffer_size() > LIMITS.buffer_bytes:
            return False
        self.read_at = now
        return True


def _parse_request(message: dict[str, Any]) -> GroundRequest:
    """Return the request in a page's message.  Raises InputError for one that pages may not make."""
    if message == {"request": "Restart"}:
        return Restart()
    request = rq.from_dict(message)
    if not isinstance(request, ALLOWED_REQUESTS):
        raise InputError(f"request = {type(request).__name__!r}: is not for the page")
    return request


def _parse_message(text: str | bytes) -> dict[str, Any]:
    """Parse a page's JSON message into a dict.  Raises InputError for anything else."""
    if isinstance(text, bytes):
        raise InputError("message: must be text")

    def refuse_constant(word: str) -> float:
        raise InputError(f"message: {word} is no number here")

    try:
        value = json.loads(text, parse_constant=refuse_constant)
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError("message: is not JSON") from None
    if not isinstance(value, dict):
        raise InputError("message: must be a table")
    return value


def _send(connection: ServerConnection, message: dict[str, Any]) -> None:
    """Send a message without blocking; a page that does not read gets nothing and is closed soon."""
    if connection.transport.get_write_buffer_size() <= 2 * LIMITS.buffer_bytes:
        broadcast([connection], _to_json(message))


def _to_json(message: dict[str, Any]) -> str:
    return json.dumps(message, separators=(",", ":"), allow_nan=False)


def _load_files(token: str, key: str, hosts: set[str]) -> dict[str, tuple[str, bytes, str]]:
    """Return the page's files by path after the key: media type, content and content security policy."""
    sockets = " ".join(sorted(f"ws://{host}" for host in hosts))
    policy = (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        f"connect-src 'self' {sockets}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    kinds = CONTENT_TYPES | {"txt": TEXT_TYPE}  # the text files are licences
    served = {
        path: (kinds[path.rpartition(".")[2]], body, policy)
        for path, body in [
            *((f"/{path.relative_to(_STATIC).as_posix()}", path.read_bytes()) for path in _STATIC.rglob("*.*")),
            *((f"/assets/{name}", (ASSETS / name).read_bytes()) for name in _REPORT_ASSETS),
        ]
        if path.rpartition(".")[2] in kinds
    }
    kind, body, _ = served.pop("/index.html")
    page = body.decode().replace(_TOKEN, escape(token)).replace(_FILES, f"/{key}").encode()
    return served | {"/": (kind, page, policy)}


def is_token(presented: Any, token: str) -> bool:
    """Return whether a presented token is the right one, compared in constant time."""
    return isinstance(presented, str) and presented.isascii() and hmac.compare_digest(presented, token)


def make_response(status: HTTPStatus, body: bytes, kind: str = TEXT_TYPE, policy: str = "") -> Response:
    """Return an HTTP response that browsers neither store nor frame; without ``policy`` it loads nothing else."""
    headers = Headers(
        {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Connection": "close",
            "Cache-Control": "no-store",
            "Content-Security-Policy": policy or "default-src 'none'; frame-ancestors 'none'",
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cross-Origin-Resource-Policy": "same-origin",
        }
    )
    return Response(status.value, status.phrase, headers, body)
