"""Who may speak with the viewer's server: its own page, and pages that the user names.

A browser sends any page's requests to this machine. So a page elsewhere could read the scene or
change what is shown, by a websocket (its `Origin` gives it away), or by a name of its own that
leads to 127.0.0.1 (its `Host` does).
"""

from __future__ import annotations

import asyncio
import ctypes
import gc
import http
import ipaddress
import logging
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any
from urllib.parse import urlsplit

from navbake.errors import NavbakeError

QUIET = logging.getLogger("navbake.viewer.web")  # of websockets, which logs what strangers send
QUIET.addHandler(logging.NullHandler())
QUIET.propagate = False
WHO = "expected the viewer's own address, got {0!r} as {1}: --allow-origin lets others in\n"


def check_origins(origins: Sequence[str]) -> None:
    """Refuse origins that no browser sends, as ``https://hub.example.org`` is."""
    for origin in origins:
        parts = urlsplit(origin)
        if parts.scheme not in ("http", "https") or origin != f"{parts.scheme}://{parts.netloc}":
            raise NavbakeError(
                f"expected an origin such as https://hub.example.org, got {origin!r}"
            )


def find_stranger(headers: Any, own: str, origins: Sequence[str]) -> str | None:
    """Why a request is no business of the viewer; None where it is.

    Addresses in digits are nobody's name, so any of them may be the `Host`. Programs other than
    browsers send no `Origin`, and may do what they may do on this machine anyway.

    Args:
        headers: of the request.
        own: the host that the server listens at.
        origins: other origins of pages that may speak with it.
    """
    host, origin = headers.get("Host", ""), headers.get("Origin")
    name = (urlsplit(f"//{host}").hostname or "").rstrip(".")
    known = {own, "localhost", socket.gethostname().lower(), socket.getfqdn().lower()}
    known |= {urlsplit(each).hostname or "" for each in origins}
    try:
        ipaddress.ip_address(name)
    except ValueError:
        if name not in known:
            return WHO.format(host, "Host")
    if origin is not None and origin not in (f"http://{host}", f"https://{host}", *origins):
        return WHO.format(origin, "Origin")
    return None


@contextmanager
def guarded(own: str, origins: Sequence[str]) -> Iterator[None]:
    """Let servers that viser starts inside answer no strangers, and log nothing of what these send.

    viser hands no options on to websockets, so what it calls there is another function meanwhile.
    """
    import websockets.asyncio.server as web  # with the extra [view]

    serve = web.serve

    def serve_guarded(*args: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            try:
                why = find_stranger(request.headers, own, origins)
            except Exception:  # several headers of one name, or a host that is none
                why = WHO.format("what is none", "Host")
            if why is not None:
                return connection.respond(http.HTTPStatus.FORBIDDEN, why)
            if "Upgrade" in request.headers:  # a page comes: those before it may have gone
                give_memory_back()
            return process_request(connection, request)

        # what a task that a message started raises is nobody's here
        asyncio.get_running_loop().set_exception_handler(lambda *_: None)
        return serve(*args, process_request=answer, logger=QUIET, **options)

    web.serve = serve_guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        web.serve = serve  # type: ignore[misc]


def give_memory_back() -> None:
    """Free what pages that were closed leave: rings of objects, and what malloc keeps of them."""
    gc.collect()
    if sys.platform == "linux":
        with suppress(AttributeError, OSError):  # another C library than GNU's has no such call
            ctypes.CDLL(None).malloc_trim(0)
