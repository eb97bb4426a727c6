"""Common parts of the servers of local pages: access checks, and headers that isolate a page.

A machine may have other accounts, and each can connect to its loopback.  Who was told the printed address gets the
page, which has the token that commands; its files and the pages that it shows are below a key of their own, which a
page that somebody else wrote may see and which commands nothing.  No cookie is set: browsers hand those of one port to
every other port of the machine.
"""

from __future__ import annotations

import hmac
import logging
import os
import socket
from collections.abc import Container
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from cosim.base.errors import InputError

WRONG_TOKEN = 4401  # a close code of our own
TEXT = "text/plain; charset=utf-8"
TYPES = {  # content types by file ending
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "svg": "image/svg+xml",
}


def listen(port: int, option: str) -> tuple[socket.socket, set[str]]:
    """Return a listening loopback socket, at any free port for 0, and the names of its server in ``Host``.

    Raises InputError, with the ``option`` that named the port, where it cannot be had.
    """
    try:
        listening = socket.create_server(("127.0.0.1", port))
    except OSError as error:
        raise InputError(f"{option} {port}: the port cannot be opened: {os.strerror(error.errno or 0)}") from error
    return listening, {f"{name}:{listening.getsockname()[1]}" for name in ("127.0.0.1", "localhost")}


def quiet_logger(name: str) -> logging.Logger:
    """Return a logger that discards everything: a browser that opens a connection ahead of need is no error."""
    quiet = logging.getLogger(name)
    quiet.addHandler(logging.NullHandler())
    quiet.propagate = False
    return quiet


def refuse_unknown_host(request: Request, hosts: Container[str]) -> Response | None:
    """Return the refusal of a request that does not name one of ``hosts`` in ``Host``; None for one that does."""
    host = request.headers.get_all("Host")
    if len(host) == 1 and host[0].lower() in hosts:
        return None
    return make_response(HTTPStatus.MISDIRECTED_REQUEST, b"This is not the server you are looking for.\n")


def refuse_non_websocket(request: Request) -> Response | None:
    """Return the refusal of a request for anything but a WebSocket, whose origin is checked next; else None."""
    if request.headers.get("Upgrade", "").lower() == "websocket":
        return None
    return make_response(HTTPStatus.UPGRADE_REQUIRED, b"A WebSocket.\n")


def has_token_query(request: Request, token: str) -> bool:
    """Return whether a request is of the printed address, ``/?token=...``."""
    path, _, query = request.path.partition("?")
    return path == "/" and any(is_token(presented, token) for presented in parse_qs(query).get("token", []))


def refuse_without_token() -> Response:
    """Return the refusal of a request that shows no token, which says where to find it."""
    text = "Open the address that hexjet has printed, with its token: this page is for those who were told it.\n"
    return make_response(HTTPStatus.FORBIDDEN, text.encode())


def is_token(presented: Any, token: str) -> bool:
    """Return whether a page has shown the token that it was given, in a time that reveals nothing of it."""
    return isinstance(presented, str) and presented.isascii() and hmac.compare_digest(presented, token)


def make_response(
    status: HTTPStatus, body: bytes, kind: str = TEXT, policy: str = "", resource_policy: str = "same-origin"
) -> Response:
    """Return an answer that browsers neither store nor frame.

    ``policy``: of its content, which without one loads nothing.  ``resource_policy``: whose pages may load it.
    """
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
            "Cross-Origin-Resource-Policy": resource_policy,
        }
    )
    return Response(status.value, status.phrase, headers, body)
