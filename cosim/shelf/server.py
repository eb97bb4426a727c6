"""The page over a folder of runs: one HTML file, the runs' own pages, and a WebSocket, on the loopback alone.

Who may ask for anything to be done: the page that this server has given out.  Every request must name this server in
``Host``, so that no other name that resolves to the loopback gets in; a WebSocket must come from this server's origin;
and its first message must carry the token that is written into the page, which no foreign page can read.  The runs'
pages are shown in a sandbox, without an origin: what stands in a run from somebody else can read no token either.
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
from urllib.parse import unquote

from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve
from websockets.typing import Origin

from cosim.base.errors import FlightError, InputError
from cosim.groundstation.web import loopback
from cosim.groundstation.web.loopback import (
    TEXT,
    WRONG_TOKEN,
    is_token,
    listen,
    no_socket,
    quiet_logger,
    response,
    stranger,
)
from cosim.shelf.index import Shelf

LARGEST = 1 << 20  # bytes of a message from the page: ten thousand names
HELLO_S = 5.0  # for the token to arrive
TYPES = loopback.TYPES | {
    "png": "image/png",
    "json": "application/json",
    "toml": TEXT,
    "csv": "text/csv; charset=utf-8",
}
ASSETS = ("css", "js")  # which a page in a sandbox asks for as if from elsewhere
SANDBOX = "sandbox allow-scripts allow-downloads"


class ShelfServer:
    """Serves a shelf; ``compare`` writes a comparison of some of its folders and says where."""

    def __init__(self, shelf: Shelf, port: int, compare: Callable[[Sequence[Path]], Path]) -> None:
        self.port = port
        self._shelf = shelf
        self._compare = compare
        self._token = secrets.token_urlsafe(24)
        self._nonce = secrets.token_urlsafe(16)
        self._busy = threading.Lock()  # one thing is done at a time
        self._server: Server | None = None

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://127.0.0.1:{self.port}/"

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
        """A file, a refusal, or None where a WebSocket may be opened (its origin is looked at next)."""
        if refusal := stranger(request, self._hosts):
            return refusal
        path = unquote(request.path.partition("?")[0])
        if path == "/live":
            return no_socket(request)
        if path == "/":
            nonce = f"'nonce-{self._nonce}'"
            policy = (
                f"default-src 'none'; script-src {nonce}; style-src {nonce}; img-src data:; "
                f"connect-src ws://127.0.0.1:{self.port} ws://localhost:{self.port}; base-uri 'none'; "
                "form-action 'none'; frame-ancestors 'none'"
            )
            return response(HTTPStatus.OK, self._page(), TYPES["html"], policy)
        if path == "/favicon.ico":  # asked for by a page in a sandbox, as if from elsewhere
            return response(HTTPStatus.NO_CONTENT, b"", share="cross-origin")
        return self._file(path.removeprefix("/run/")) if path.startswith("/run/") else _not_found()

    def _page(self) -> bytes:
        page = (files("cosim.shelf") / "templates" / "shelf.html").read_text(encoding="utf-8")
        page = page.replace("@TOKEN@", escape(self._token)).replace("@NONCE@", escape(self._nonce))
        return page.replace("@FOLDER@", escape(str(self._shelf.folder))).encode()

    def _file(self, name: str) -> Response:
        """A file below the folder of runs, of a kind that a page is made of."""
        root = self._shelf.folder.resolve()
        ending = name.rpartition(".")[2].lower()
        try:
            path = (root / name).resolve()
            if ending not in TYPES or not path.is_relative_to(root) or path.name.startswith(".") or not path.is_file():
                return _not_found()
            body = path.read_bytes()
        except (OSError, ValueError):
            return _not_found()
        share = "cross-origin" if ending in ASSETS else "same-origin"
        return response(HTTPStatus.OK, body, TYPES[ending], SANDBOX, share)

    # --- the page's questions ------------------------------------------------------------------------------------

    def _serve(self, connection: ServerConnection) -> None:
        """One WebSocket, from its first message to its end."""
        try:
            token = _parsed(connection.recv(HELLO_S)).get("token")
            if not is_token(token, self._token):
                connection.close(WRONG_TOKEN, "wrong token")
                return
            connection.send(self._rows())
            for text in connection:
                with self._busy:
                    connection.send(self._do(_parsed(text)))
                    connection.send(self._rows())
        except (ConnectionClosed, TimeoutError):
            pass

    def _rows(self) -> str:
        """All of it: rows, and each metric's name once."""
        entries = self._shelf.entries()
        names = sorted({name for entry in entries for name in entry.metrics})
        rows = [
            [entry.name, entry.kind, entry.facts, entry.tags, entry.page, [entry.metrics.get(name) for name in names]]
            for entry in entries
        ]
        return json.dumps({"metrics": names, "rows": rows})

    def _do(self, asked: dict[str, Any]) -> str:
        """What the page asks for; the answer is what is told about it."""
        what, names = asked.get("do"), asked.get("names")
        chosen = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
        try:
            if what == "delete":
                for name in chosen:
                    self._shelf.delete(name)
                return json.dumps({"said": f"{len(chosen)} deleted"})
            if what == "tag":
                self._shelf.tag(chosen, _texts(asked.get("add")), _texts(asked.get("remove")))
                return json.dumps({"said": f"{len(chosen)} tagged"})
            if what == "compare":
                page = self._compare([self._shelf.place(name) for name in chosen])
                place = page.resolve().relative_to(self._shelf.folder.resolve()).as_posix()
                return json.dumps({"said": f"written: {page}", "open": f"/run/{place}"})
            return json.dumps({"said": ""})
        except (InputError, FlightError) as error:
            return json.dumps({"said": str(error), "failed": True})


def _texts(value: Any) -> list[str]:
    return [item for item in value if isinstance(item, str)] if isinstance(value, list) else []


def _parsed(text: str | bytes) -> dict[str, Any]:
    """A message as a table; what is none is an empty one."""
    try:
        message = json.loads(text)
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}


def _not_found() -> Response:
    return response(HTTPStatus.NOT_FOUND, b"Not found.\n")
