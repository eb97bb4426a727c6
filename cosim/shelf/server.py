"""The page over a folder of runs: one HTML file, the runs' own pages, and a WebSocket, on the loopback alone.

Who may ask for anything to be done: the page that this server has given out, to who asked for the printed address with
its token.  Every request must name this server in ``Host``, so that no other name that resolves to the loopback gets
in; a WebSocket must come from this server's origin; and its first message must carry the token, which no foreign page
can read.

A run's page may be somebody else's.  It is shown in a frame of a page of ours, in a sandbox, without an origin: it can
read nothing of this server, its policy has it load nothing from elsewhere, and that of the page around it has the frame
go nowhere else.  The key in its own address lets it see pages of runs, and nothing more.
"""

from __future__ import annotations

import json
import secrets
import threading
from collections.abc import Callable, Sequence
from html import escape
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve
from websockets.typing import Origin

from cosim.base.errors import FlightError, InputError
from cosim.groundstation.web import loopback
from cosim.groundstation.web.loopback import (
    TEXT,
    WRONG_TOKEN,
    has_token_query,
    is_token,
    listen,
    make_response,
    quiet_logger,
    refuse_non_websocket,
    refuse_unknown_host,
    refuse_without_token,
)
from cosim.shelf.index import Shelf

LARGEST = 1 << 20  # bytes of a message from the page: ten thousand names
HELLO_S = 5.0  # s until the token must have arrived
TYPES = loopback.TYPES | {
    "png": "image/png",
    "json": "application/json",
    "toml": TEXT,
    "csv": "text/csv; charset=utf-8",
}
ASSETS = ("css", "js")  # assets that a sandboxed page requests as if from elsewhere
ALLOWED = "allow-scripts allow-downloads"  # to a run's page
PAGES = ("html", "svg")  # types of files that may contain scripts
FRAMED = "page"  # the query of a run's page inside its frame
FRAME = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{name}</title><link rel="icon" href="data:,">
<style nonce="{nonce}">html, body, iframe {{ margin: 0; border: 0; width: 100%; height: 100%; display: block; }}</style>
<iframe src="{name}?{framed}" title="{name}" sandbox="{allowed}" allow="fullscreen"></iframe></html>
"""


class ShelfServer:
    """HTTP and WebSocket server of the run browser; ``compare`` writes a comparison of folders and returns its path."""

    def __init__(self, shelf: Shelf, port: int, compare: Callable[[Sequence[Path]], Path]) -> None:
        self.port = port
        self._shelf = shelf
        self._compare = compare
        self._token, self._key = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        self._nonce = secrets.token_urlsafe(16)
        self._busy = threading.Lock()  # serialises changes of the folder
        self._server: Server | None = None

    @property
    def url(self) -> str:
        """Address of the page with its token, which is for those alone who may tag, compare and delete."""
        return f"http://127.0.0.1:{self.port}/?token={self._token}"

    def open(self) -> None:
        """Listen from now on.  Raises InputError where the port cannot be had."""
        listening, self._hosts = listen(self.port, "--port")
        self.port = listening.getsockname()[1]
        self._server = serve(
            self._serve,
            sock=listening,
            origins=[Origin(f"http://{host}") for host in self._hosts],
            process_request=self._answer,
            compression=None,
            open_timeout=HELLO_S,
            max_size=LARGEST,
            server_header=None,
            logger=quiet_logger("cosim.shelf"),
        )

    def run(self) -> None:
        """Serve until :meth:`close` is called from another thread, or Ctrl-C."""
        assert self._server is not None
        self._server.serve_forever()

    def close(self) -> None:
        """Serve no more; may be called twice."""
        if self._server is not None:
            self._server.shutdown()

    # --- files ---------------------------------------------------------------------------------------------------

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return a file or a refusal, or None where a WebSocket may be opened (its origin is checked next)."""
        if refusal := refuse_unknown_host(request, self._hosts):
            return refusal
        path, _, query = request.path.partition("?")
        if path == "/live":
            return refuse_non_websocket(request)
        if path == "/favicon.ico":  # asked for by a page in a sandbox, as if from elsewhere
            return make_response(HTTPStatus.NO_CONTENT, b"", resource_policy="cross-origin")
        if has_token_query(request, self._token):
            nonce = f"'nonce-{self._nonce}'"
            policy = (
                f"default-src 'none'; script-src {nonce}; style-src {nonce}; img-src data:; "
                f"connect-src ws://127.0.0.1:{self.port} ws://localhost:{self.port}; base-uri 'none'; "
                "form-action 'none'; frame-ancestors 'none'"
            )
            return make_response(HTTPStatus.OK, self._page(), TYPES["html"], policy)
        runs, _, rest = path.removeprefix("/").partition("/")
        key, _, name = rest.partition("/")
        if runs != "run" or not is_token(key, self._key):
            return refuse_without_token()
        destination = request.headers.get("Sec-Fetch-Dest", "iframe" if query == FRAMED else "document")
        return self._file(unquote(name), destination == "document")

    def _page(self) -> bytes:
        page = (files("cosim.shelf") / "templates" / "shelf.html").read_text(encoding="utf-8")
        page = page.replace("@TOKEN@", escape(self._token)).replace("@NONCE@", escape(self._nonce))
        page = page.replace("@RUNS@", f"/run/{self._key}")
        return page.replace("@FOLDER@", escape(str(self._shelf.folder))).encode()

    def _file(self, name: str, alone: bool) -> Response:
        """Return a file below the folder of runs, of a type that pages use; ``alone``: a page comes in its frame."""
        root = self._shelf.folder.resolve()
        ending = name.rpartition(".")[2].lower()
        try:
            path = (root / name).resolve()
            if ending not in TYPES or not path.is_relative_to(root) or path.name.startswith(".") or not path.is_file():
                return _not_found()
            body = path.read_bytes()
        except (OSError, ValueError):
            return _not_found()
        if alone and ending in PAGES:
            return self._frame(path.name)
        resource_policy = "cross-origin" if ending in ASSETS else "same-origin"
        answer = make_response(HTTPStatus.OK, body, TYPES[ending], self._policy(), resource_policy)
        del answer.headers["X-Frame-Options"]  # the policy says whose frame it may be in
        answer.headers["X-DNS-Prefetch-Control"] = "off"
        return answer

    def _frame(self, name: str) -> Response:
        """Return the page around a run's page; its policy lets the frame navigate to pages of runs alone."""
        nonce = self._nonce
        page = FRAME.format(name=escape(quote(name)), nonce=nonce, framed=FRAMED, allowed=ALLOWED)
        policy = (
            f"default-src 'none'; frame-src {self._runs()}; style-src 'nonce-{nonce}'; img-src data:; base-uri 'none'; "
            "form-action 'none'; frame-ancestors 'none'"
        )
        return make_response(HTTPStatus.OK, page.encode(), TYPES["html"], policy)

    def _policy(self) -> str:
        """Return the content policy of a run's page: it may load what is in it, and files of runs."""
        runs, hosts = self._runs(), " ".join(f"http://{host}" for host in sorted(self._hosts))
        return (
            f"sandbox {ALLOWED}; default-src 'none'; script-src 'unsafe-inline' {runs}; "
            f"style-src 'unsafe-inline' {runs}; img-src data: blob: {runs}; font-src data:; frame-src {runs}; "
            f"base-uri 'none'; form-action 'none'; frame-ancestors {hosts}"
        )

    def _runs(self) -> str:
        """Return the addresses of runs' files, as the sources of a content policy."""
        return " ".join(f"http://{host}/run/{self._key}/" for host in sorted(self._hosts))

    # --- the page's questions ------------------------------------------------------------------------------------

    def _serve(self, connection: ServerConnection) -> None:
        """Serve one WebSocket from its first message to its end."""
        try:
            token = _parse_message(connection.recv(HELLO_S)).get("token")
            if not is_token(token, self._token):
                connection.close(WRONG_TOKEN, "wrong token")
                return
            connection.send(self._rows())
            for text in connection:
                with self._busy:
                    connection.send(self._do(_parse_message(text)))
                    connection.send(self._rows())
        except (ConnectionClosed, TimeoutError):
            pass

    def _rows(self) -> str:
        """Return the whole index as JSON: rows, and each metric's name once."""
        entries = self._shelf.entries()
        names = sorted({name for entry in entries for name in entry.metrics})
        rows = [
            [entry.name, entry.kind, entry.details, entry.tags, entry.page, [entry.metrics.get(name) for name in names]]
            for entry in entries
        ]
        return json.dumps({"metrics": names, "rows": rows})

    def _do(self, request: dict[str, Any]) -> str:
        """Execute a request of the page, and return as JSON the message that it shows."""
        action, names = request.get("do"), request.get("names")
        chosen = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
        try:
            if action == "delete":
                for name in chosen:
                    self._shelf.delete(name)
                return json.dumps({"said": f"{len(chosen)} deleted"})
            if action == "tag":
                self._shelf.tag(chosen, _texts(request.get("add")), _texts(request.get("remove")))
                return json.dumps({"said": f"{len(chosen)} tagged"})
            if action == "compare":
                page = self._compare([self._shelf.path(name) for name in chosen])
                place = page.resolve().relative_to(self._shelf.folder.resolve()).as_posix()
                return json.dumps({"said": f"written: {page}", "open": f"/run/{self._key}/{quote(place)}"})
            return json.dumps({"said": ""})
        except (InputError, FlightError) as error:
            return json.dumps({"said": str(error), "failed": True})


def _texts(value: Any) -> list[str]:
    return [item for item in value if isinstance(item, str)] if isinstance(value, list) else []


def _parse_message(text: str | bytes) -> dict[str, Any]:
    """Return a JSON message as a dict, which is empty for anything else."""
    try:
        message = json.loads(text)
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}


def _not_found() -> Response:
    return make_response(HTTPStatus.NOT_FOUND, b"Not found.\n")
