"""The web server of the viewer: viser's, behind a port that checks who asks."""

from __future__ import annotations

import asyncio
import errno
import html
import io
import logging
import secrets
import socket
import sys
import threading
import urllib.request
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import AbstractContextManager, redirect_stdout, suppress
from email.message import Message
from email.parser import BytesHeaderParser
from functools import partial
from ipaddress import ip_address
from urllib.parse import urlsplit

from navbake.errors import MissingDependencyError, NavbakeError

HOST = "127.0.0.1"
PORT = 8080
EVERYWHERE = ("0.0.0.0", "::", "")  # hosts that stand for all addresses of this machine
LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")
MISSING_VISER = 'the viewer needs viser: pip install "navbake[view]"'
PORT_IN_USE = "port {1} of {0} is in use: choose another one by --port, or 0 for any free one"
VISER_TITLE = b"<title>Viser</title>"
# of a request, and what is passed on at once [bytes]
MAX_HEAD_SIZE = 1 << 16
CHUNK_SIZE = 1 << 16
HEAD_TIMEOUT = 10.0  # for the head of a request [s]
FORBIDDEN_RESPONSE = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
NO_CONTENT_RESPONSE = b"HTTP/1.1 204 No Content\r\nConnection: close\r\n\r\n"
# the page tells that its reader's system is dark
DARK_MODE_SCRIPT = (
    b'<script>if (matchMedia("(prefers-color-scheme: dark)").matches) fetch("dark")</script>'
)
PAGE_RESPONSE = (
    b"HTTP/1.1 200 OK\r\nContent-Type: text/html; charset=utf-8\r\nConnection: close\r\n"
)


class PageServer(AbstractContextManager["PageServer"]):
    """A server of an empty page at an address of this machine; port 0 means any free port.

    viser answers everybody, so it listens at a random address of the loopback network, and this
    server forwards only allowed requests to it. The header Host of a request must be the page's own
    address, against DNS rebinding, and its Origin must be a page at that address or one of
    `allowed`.

    Attributes:
        viser: the viser.ViserServer.
        url: the address of the page.
        title: the title of the page; a change shows when a page is loaded.
        on_dark: a function that is called when a user's browser prefers dark pages.

    Raises:
        MissingDependencyError: viser is not installed.
        NavbakeError: the server can't listen at the address, or an origin is invalid.
    """

    def __init__(self, host: str = HOST, port: int = PORT, *, allowed: Iterable[str] = ()) -> None:
        try:
            import viser  # of the extra [view], and slow to load
        except ImportError as error:
            raise MissingDependencyError(MISSING_VISER) from error
        self._names = {*LOCAL_HOSTS, socket.gethostname().lower()} if host in EVERYWHERE else {host}
        self._names |= {*LOCAL_HOSTS} if host in LOCAL_HOSTS else set()
        self._is_open = host in EVERYWHERE
        self._allowed = {check_origin(one) for one in allowed}
        self.title = "navbake"
        self.on_dark: Callable[[], None] = lambda: None
        # until viser is there
        self._inner = (HOST, 0)
        self._page = b""
        listening: Future[int] = Future()
        serve = partial(asyncio.run, self._serve(host, port, listening))
        self._thread = threading.Thread(target=serve, name="server", daemon=True)
        self._thread.start()
        try:
            self.port = listening.result()
        except (OSError, UnicodeError, OverflowError) as error:
            text = f"{host!r}, port {port}, is no address of this machine"
            if isinstance(error, OSError) and not isinstance(error, socket.gaierror):
                text = f"cannot listen at {host}, port {port}: {error.strerror}"
                text = PORT_IN_USE.format(host, port) if error.errno == errno.EADDRINUSE else text
            raise NavbakeError(text) from error
        shown = "localhost" if host in EVERYWHERE else f"[{host}]" if ":" in host else host
        self.url = f"http://{shown}:{self.port}"
        # a stranger's message is no traceback on the terminal
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        inner = HOST
        if sys.platform == "linux":  # where all of 127.0.0.0/8 is this machine
            inner = "127." + ".".join(str(1 + secrets.randbelow(254)) for _ in range(3))
        with redirect_stdout(io.StringIO()):  # viser prints its address in a box
            self.viser = viser.ViserServer(host=inner, port=0, verbose=False)
        # viser's own page can ask for a tunnel to its makers' server: nothing leaves this machine
        self.viser.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
        self._inner = inner, self.viser.get_port()
        with urllib.request.urlopen("http://{}:{}/".format(*self._inner)) as page:
            self._page = page.read()

    async def _serve(self, host: str, port: int, listening: Future[int]) -> None:
        """Serve until `close`; `asyncio.run` cancels the connections that are open then."""
        self._loop = asyncio.get_running_loop()
        self._closing = asyncio.Event()
        try:
            server = await asyncio.start_server(
                self._answer, host or None, port, limit=MAX_HEAD_SIZE
            )
        except Exception as error:
            listening.set_exception(error)
            return
        listening.set_result(server.sockets[0].getsockname()[1])
        await self._closing.wait()
        server.close()

    def close(self) -> None:
        """Stop the server, and free the port."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._closing.set)
            self._thread.join()
            with redirect_stdout(io.StringIO()):
                self.viser.stop()

    def __exit__(self, *_: object) -> None:
        self.close()

    def is_allowed(self, headers: Message) -> bool:
        """Return whether a request's Host is the page's address and its Origin is allowed."""
        hosts = headers.get_all("Host", [])
        origins = headers.get_all("Origin", [])
        if len(hosts) != 1 or len(origins) > 1:
            return False
        try:
            address = urlsplit(f"//{hosts[0]}")
            name = address.hostname or ""
            port = address.port or 80
        except ValueError:  # a port that is none
            return False
        is_own = port == self.port and name in self._names
        if self._is_open and port == self.port:
            with suppress(ValueError):  # a name, which anybody can let point here
                is_own |= bool(ip_address(name))
        is_own |= hosts[0] in {urlsplit(origin).netloc for origin in self._allowed}
        return is_own and (not origins or origins[0] in {f"http://{hosts[0]}", *self._allowed})

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one connection, or pass it on; viser's server takes one request of each."""
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_TIMEOUT)
            request, _, lines = head.partition(b"\r\n")
            headers = BytesHeaderParser().parsebytes(lines)
            if not self.is_allowed(headers):
                writer.write(FORBIDDEN_RESPONSE)
            elif request.startswith(b"GET / ") and "Upgrade" not in headers:
                title = f"<title>{html.escape(self.title)}</title>".encode()
                page = self._page.replace(VISER_TITLE, title + DARK_MODE_SCRIPT, 1)
                writer.write(PAGE_RESPONSE + b"Content-Length: %d\r\n\r\n" % len(page) + page)
                await writer.drain()
            elif request.startswith(b"GET /dark "):
                self.on_dark()
                writer.write(NO_CONTENT_RESPONSE)
            else:
                there, back = await asyncio.open_connection(*self._inner)
                back.write(head)
                await asyncio.gather(_pass_on(reader, back), _pass_on(there, writer))
        except (OSError, EOFError, asyncio.LimitOverrunError, asyncio.TimeoutError):
            pass  # whoever asked has gone, or speaks no HTTP
        finally:
            writer.close()


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Write all that comes from one side to the other, until one of them ends."""
    try:
        while data := await reader.read(CHUNK_SIZE):
            writer.write(data)
            await writer.drain()
    finally:
        writer.close()


def check_origin(text: str) -> str:
    """Return an origin as browsers send it, as ``https://a.org:8443``.

    Raises:
        NavbakeError: the text is no origin.
    """
    parts = urlsplit(text)
    if parts.scheme not in ("http", "https") or f"{parts.scheme}://{parts.netloc}" != text:
        raise NavbakeError(f"expected an origin like https://example.org:8443, got {text!r}")
    return text
