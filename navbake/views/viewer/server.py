"""The web server of the viewer: it checks each request, and forwards it to viser's server."""

from __future__ import annotations

import asyncio
import errno
import html
import io
import logging
import re
import secrets
import socket
import sys
import threading
import urllib.request
from collections.abc import Iterable
from concurrent.futures import Future
from contextlib import AbstractContextManager, redirect_stdout
from email.message import Message
from email.parser import BytesHeaderParser
from functools import partial
from ipaddress import ip_address
from urllib.parse import urlsplit

from navbake.errors import MissingDependencyError, NavbakeError

HOST = "127.0.0.1"
PORT = 8080
ALL_ADDRESSES = ("0.0.0.0", "::", "")  # hosts that stand for all addresses of this machine
LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")  # hosts that only this machine can reach
MISSING_VISER = 'the viewer needs viser: pip install "navbake[view]"'
PORT_IN_USE_TEXT = "port {1} of {0} is in use: choose another one by --port, or 0 for any free one"
VISER_TITLE = b"<title>Viser</title>"
MAX_HEAD_SIZE = 1 << 16  # largest head (first line and headers) of a request [bytes]
CHUNK_SIZE = 1 << 16  # how much is forwarded at once [bytes]
HEAD_TIMEOUT = 10.0  # how long the head of a request may take to arrive [s]
FORBIDDEN_RESPONSE = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
# In the storage of a reader's browser: what the reader chose for the page, and what the reader's
# system prefers; `DARK` or `LIGHT`
PAGE_KEY = "navbake-page"
SYSTEM_KEY = "navbake-system"
DARK = "dark"
LIGHT = "light"
VISER_KEY_PREFIX = "viser-user:"  # of what viser's `local_storage` reads and writes
# by this script, the page stores what its reader's system prefers
SYSTEM_SCRIPT = (
    f'<script>try {{ localStorage.setItem("{VISER_KEY_PREFIX}{SYSTEM_KEY}", matchMedia('
    f'"(prefers-color-scheme: dark)").matches ? "{DARK}" : "{LIGHT}") }} catch {{}}</script>'
).encode()
# On a phone, viser's panel covers most of the scene, and its server can't fold it. This script
# clicks the panel's bar, which folds it, when it appears.
FOLD_SCRIPT = b"""<script>
if (matchMedia("(max-width: 36em)").matches) {
  const observer = new MutationObserver(() => {
    const bar = document.querySelector('[style*="height: 3.5em"][style*="cursor: pointer"]');
    if (bar) { observer.disconnect(); bar.click(); }
  });
  observer.observe(document, { childList: true, subtree: true });
}
</script>"""
PAGE_REQUEST = re.compile(rb"GET /(?:\?\S*)? ")
# no page of another site may show this one in a frame, and lead clicks to it
FRAME_HEADER = b"Content-Security-Policy: frame-ancestors 'none'\r\n"
PAGE_RESPONSE = (
    b"HTTP/1.1 200 OK\r\nContent-Type: text/html; charset=utf-8\r\nConnection: close\r\n"
    + FRAME_HEADER
)
# a request's Host: an IPv6 address in brackets, or a name, then perhaps a port
HOST_PATTERN = re.compile(r"(?:\[([0-9a-f:.]+)\]|([^\s\[\]@:/?#\\]+))(?::([1-9][0-9]{,4}))?")
OWN_SITES = ("same-origin", "none")  # of Sec-Fetch-Site; none: the user has typed the address


class PageServer(AbstractContextManager["PageServer"]):
    """The server of the viewer's page, which stands in front of viser's server.

    viser's own server answers everybody. Therefore it listens at a random address of the loopback
    network, and this server forwards only allowed requests to it, see `is_allowed`. The page is
    empty until the viewer adds a scene to `viser`.

    Attributes:
        viser: the viser.ViserServer.
        url: the address of the page.
        port: the port of the page.
        title: the title of the page; a new title shows when the page is loaded the next time.
    """

    def __init__(self, host: str = HOST, port: int = PORT, *, allowed: Iterable[str] = ()) -> None:
        """Start the server.

        Args:
            host: the address of this machine to listen at.
            port: the port to listen at; 0 for any free port.
            allowed: further origins of pages that may use the server, see `check_origin`.

        Raises:
            MissingDependencyError: viser is not installed.
            NavbakeError: the server can't listen at the address, or an origin is invalid.
        """
        try:
            import viser  # of the extra [view], and slow to load
        except ImportError as error:
            raise MissingDependencyError(MISSING_VISER) from error
        self._listens_everywhere = host in ALL_ADDRESSES
        # names of this machine that a request may have as its host
        if self._listens_everywhere:
            self._host_names = {*LOCAL_HOSTS, socket.gethostname().lower()}
        elif host in LOCAL_HOSTS:
            self._host_names = {*LOCAL_HOSTS}
        else:
            self._host_names = {host.lower()}
        self._allowed_origins = {check_origin(origin) for origin in allowed}
        self.title = "navbake"
        # address and port of viser's server, and its page; set when that server has started
        self._viser_address = (HOST, 0)
        self._viser_page = b""
        port_future: Future[int] = Future()
        serve = partial(asyncio.run, self._serve(host, port, port_future))
        self._thread = threading.Thread(target=serve, name="server", daemon=True)
        self._thread.start()
        try:
            self.port = port_future.result()
        except (OSError, UnicodeError, OverflowError) as error:
            message = f"{host!r}, port {port}, is no address of this machine"
            if isinstance(error, OSError) and not isinstance(error, socket.gaierror):
                message = f"cannot listen at {host}, port {port}: {error.strerror}"
                if error.errno == errno.EADDRINUSE:
                    message = PORT_IN_USE_TEXT.format(host, port)
            raise NavbakeError(message) from error
        url_host = f"[{host}]" if ":" in host else host
        if self._listens_everywhere:
            url_host = "localhost"
        self.url = f"http://{url_host}:{self.port}"
        # a broken message, which anybody may send, is no reason for a traceback on the terminal
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        viser_host = HOST
        if sys.platform == "linux":  # here all of 127.0.0.0/8 is this machine
            viser_host = "127." + ".".join(str(1 + secrets.randbelow(254)) for _ in range(3))
        with redirect_stdout(io.StringIO()):  # viser prints its address in a box
            self.viser = viser.ViserServer(host=viser_host, port=0, verbose=False)
        # viser's page could ask for a tunnel to a server of viser's makers: that is switched off
        self.viser.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
        self._viser_address = (viser_host, self.viser.get_port())
        with urllib.request.urlopen("http://{}:{}/".format(*self._viser_address)) as page:
            self._viser_page = page.read()

    async def _serve(self, host: str, port: int, port_future: Future[int]) -> None:
        """Serve until `close` is called; then `asyncio.run` cancels the open connections.

        Args:
            host: the address to listen at.
            port: the port to listen at; 0 for any free port.
            port_future: receives the port, or the error if the server can't listen.
        """
        self._loop = asyncio.get_running_loop()
        self._closing = asyncio.Event()
        try:
            page_server = await asyncio.start_server(
                self._answer, host or None, port, limit=MAX_HEAD_SIZE
            )
        except Exception as error:
            port_future.set_exception(error)
            return
        port_future.set_result(page_server.sockets[0].getsockname()[1])
        await self._closing.wait()
        page_server.close()

    def close(self) -> None:
        """Stop the server, and free the port."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._closing.set)
            self._thread.join()
            with redirect_stdout(io.StringIO()):
                self.viser.stop()

    def __exit__(self, *_: object) -> None:
        self.close()

    def is_allowed(self, headers: Message, *, is_page: bool = False) -> bool:
        """Return whether a request may be answered.

        - Host must be the page's own address, or the host of an allowed origin. If the page listens
          at all addresses, any numeric address with its port is its own. This prevents DNS
          rebinding.
        - Origin must be a page at the address in Host, or one of the allowed origins.
        - Without Origin, which browsers leave out when they load an image or a script,
          Sec-Fetch-Site must say that a page at the address in Host makes the request. Clients that
          leave out both are allowed. So is a link from another site to the page itself.

        Args:
            headers: The headers of the request.
            is_page: Whether the request asks for the page itself.
        """
        host_headers = headers.get_all("Host", [])
        origin_headers = headers.get_all("Origin", [])
        if (
            len(host_headers) != 1
            or len(origin_headers) > 1
            or not self._is_own_host(host_headers[0])
        ):
            return False
        if origin_headers:
            return origin_headers[0] in {f"http://{host_headers[0]}", *self._allowed_origins}
        follows_link = is_page and headers.get_all("Sec-Fetch-Dest") == ["document"]
        fetch_sites = headers.get_all("Sec-Fetch-Site", [])
        return follows_link or all(site in OWN_SITES for site in fetch_sites)

    def _is_own_host(self, host: str) -> bool:
        """Return whether a header Host is the page's own address, or the host of an allowed origin.

        Args:
            host: The whole header.
        """
        if host in {urlsplit(origin).netloc for origin in self._allowed_origins}:
            return True
        host_match = HOST_PATTERN.fullmatch(host.lower())
        if host_match is None or int(host_match[3] or 80) != self.port:
            return False
        host_name = host_match[1] or host_match[2]
        if host_name in self._host_names or not self._listens_everywhere:
            return host_name in self._host_names
        # A numeric address is this machine's, but anybody can make a name point to it.
        try:
            ip_address(host_name)
        except ValueError:  # it is a name
            return False
        return True

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer the request of a connection, or forward the connection to viser's server.

        viser's server takes only one request on each connection, so that one check is enough.
        """
        try:
            request_head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_TIMEOUT)
            request_line, _, header_lines = request_head.partition(b"\r\n")
            headers = BytesHeaderParser().parsebytes(header_lines)
            is_page = bool(PAGE_REQUEST.match(request_line)) and "Upgrade" not in headers
            if not self.is_allowed(headers, is_page=is_page):
                writer.write(FORBIDDEN_RESPONSE)
            elif is_page:
                title = f"<title>{html.escape(self.title)}</title>".encode()
                page = self._viser_page.replace(VISER_TITLE, title + SYSTEM_SCRIPT + FOLD_SCRIPT, 1)
                writer.write(PAGE_RESPONSE + b"Content-Length: %d\r\n\r\n" % len(page) + page)
                await writer.drain()
            else:
                viser_reader, viser_writer = await asyncio.open_connection(*self._viser_address)
                viser_writer.write(request_head)
                try:
                    response_head = await viser_reader.readuntil(b"\r\n\r\n")
                    status_line, _, header_lines = response_head.partition(b"\r\n")
                    writer.write(status_line + b"\r\n" + FRAME_HEADER + header_lines)
                    await asyncio.gather(
                        _forward(reader, viser_writer), _forward(viser_reader, writer)
                    )
                finally:
                    viser_writer.close()
        except (OSError, EOFError, asyncio.LimitOverrunError, asyncio.TimeoutError):
            pass  # the client has closed the connection, or doesn't speak HTTP
        finally:
            writer.close()


async def _forward(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Write all that a reader receives, until the reader or the writer is closed."""
    try:
        while chunk := await reader.read(CHUNK_SIZE):
            writer.write(chunk)
            await writer.drain()
    finally:
        writer.close()


def check_origin(origin: str) -> str:
    """Check that a text is an origin in the form that browsers send: ``https://a.org:8443``.

    Returns:
        The text.

    Raises:
        NavbakeError: it isn't an origin.
    """
    url_parts = urlsplit(origin)
    if (
        url_parts.scheme not in ("http", "https")
        or f"{url_parts.scheme}://{url_parts.netloc}" != origin
    ):
        raise NavbakeError(f"expected an origin like https://example.org:8443, got {origin!r}")
    return origin
