"""What the servers of pages on this machine share: who may come in, and headers that keep a page to itself."""

from __future__ import annotations

import hmac
from collections.abc import Container
from http import HTTPStatus
from typing import Any

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

WRONG_TOKEN = 4401  # a close code of our own
TEXT = "text/plain; charset=utf-8"
TYPES = {  # by what a file's name ends with
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "svg": "image/svg+xml",
}


def stranger(request: Request, hosts: Container[str]) -> Response | None:
    """The refusal of a request that does not name one of ``hosts`` in ``Host``; None for one that does."""
    host = request.headers.get_all("Host")
    if len(host) == 1 and host[0].lower() in hosts:
        return None
    return response(HTTPStatus.MISDIRECTED_REQUEST, b"This is not the server you are looking for.\n")


def no_socket(request: Request) -> Response | None:
    """The refusal of a request that asks for no WebSocket; None for one that does (its origin is looked at next)."""
    if request.headers.get("Upgrade", "").lower() == "websocket":
        return None
    return response(HTTPStatus.UPGRADE_REQUIRED, b"A WebSocket.\n")


def is_token(shown: Any, token: str) -> bool:
    """Whether a page has shown the token that it was given, in a time that tells nothing of it."""
    return isinstance(shown, str) and shown.isascii() and hmac.compare_digest(shown, token)


def response(
    status: HTTPStatus, body: bytes, kind: str = TEXT, policy: str = "", share: str = "same-origin"
) -> Response:
    """An answer that is neither kept nor framed; ``policy`` is that of its content, which without one loads nothing;
    ``share`` says whose pages may load it.
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
            "Cross-Origin-Resource-Policy": share,
        }
    )
    return Response(status.value, status.phrase, headers, body)
