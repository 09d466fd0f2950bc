"""The web server of the viewer: viser's, kept to this machine and quiet."""

from __future__ import annotations

import errno
import io
import socket
from contextlib import redirect_stdout
from importlib.util import find_spec
from typing import TYPE_CHECKING

from navbake.errors import MissingDependencyError, NavbakeError

if TYPE_CHECKING:
    import viser

MISSING = 'the viewer needs viser: pip install "navbake[view]"'
HOST, PORT = "127.0.0.1", 8080
EVERYWHERE = ("0.0.0.0", "::", "")  # hosts that stand for all addresses of this machine


def open_server(host: str = HOST, port: int = PORT) -> viser.ViserServer:
    """Serve an empty page.

    Args:
        host: address of this machine to listen at; only this machine can reach loopback.
        port: 0 for any that is free.

    Raises:
        MissingDependencyError: viser is not installed.
        NavbakeError: the port is taken, or there is no such address here.
    """
    check_viser()
    # viser takes the next free port, without a word, and waits forever for an unknown host
    check_address(host, port)
    try:
        import viser  # of the extra [view], and slow to load
    except ImportError as error:
        raise MissingDependencyError(f"{MISSING} ({error})") from error
    with redirect_stdout(io.StringIO()):  # viser prints its address in a box
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if port and server.get_port() != port:
        close_server(server)
        raise NavbakeError(_taken(host, port))
    # viser's own page can ask for a tunnel to its makers' server: nothing leaves this machine
    server.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop serving, and free the port."""
    with redirect_stdout(io.StringIO()):
        server.stop()


def url_of(server: viser.ViserServer) -> str:
    """The address of the page, for a browser on this machine."""
    host = server.get_host()
    host = "localhost" if host in EVERYWHERE else host
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}"


def check_viser() -> None:
    """Raise where viser is not installed."""
    try:
        is_there = find_spec("viser") is not None
    except (ImportError, ValueError):  # something keeps it from being found
        is_there = False
    if not is_there:
        raise MissingDependencyError(MISSING)


def check_address(host: str, port: int) -> None:
    """Raise where nothing can listen at an address now."""
    if not 0 <= port <= 65535:
        raise NavbakeError(f"expected a port from 0 to 65535, got {port}")
    try:
        kind, _, _, _, address = socket.getaddrinfo(
            host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(kind, socket.SOCK_STREAM) as probe:
            # a port that was closed a moment ago can be taken again, as the server takes it
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen()
    except (socket.gaierror, UnicodeError) as error:
        raise NavbakeError(f"{host!r} is no address of this machine") from error
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise NavbakeError(_taken(host, port)) from error
        raise NavbakeError(f"cannot listen at {host}, port {port}: {error.strerror}") from error


def _taken(host: str, port: int) -> str:
    return f"port {port} of {host} is in use: choose another one by --port, or 0 for any free one"
