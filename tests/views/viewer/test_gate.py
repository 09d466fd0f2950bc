"""The viewer's server answers its own page, and no page from elsewhere."""

import asyncio
import http.client
import os
import sys
from contextlib import suppress
from urllib.parse import urlsplit

import pytest

from navbake.errors import NavbakeError
from navbake.views.viewer.view import close_server, open_server, url_of
from viewer_page import run_view
from viewer_scenes import write_room

viser = pytest.importorskip("viser")
client = pytest.importorskip("websockets.asyncio.client")
msgspec = pytest.importorskip("msgspec")
zstandard = pytest.importorskip("zstandard")
exceptions = pytest.importorskip("websockets.exceptions")


@pytest.fixture(scope="module")
def server():
    made = open_server(port=0, origins=["https://hub.example.org"])
    yield url_of(made)
    close_server(made)


def status(url, **headers):
    """How the server answers a request for the page."""
    asked = http.client.HTTPConnection(urlsplit(url).netloc, timeout=10)
    asked.request("GET", "/", headers=headers)
    answer = asked.getresponse()
    return answer.status, answer.read()[:200].decode()


async def talk(url, *messages, **headers):
    """Open a websocket as the page does, send messages, and return what comes first."""
    protocol = f"viser-v{viser.__version__}"
    options = {"subprotocols": [protocol], "max_size": None, "additional_headers": headers}
    async with client.connect(url.replace("http", "ws"), **options) as socket:
        for message in messages:
            await socket.send(message)
        return await asyncio.wait_for(socket.recv(), 10)


async def load_with(protocol, url):
    async with client.connect(url.replace("http", "ws"), subprotocols=[protocol]) as socket:
        await socket.recv()


def port_of(url):
    return urlsplit(url).port


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "192.0.2.1", "[::1]", "LocalHost."])
def test_its_own_names_are_let_in(server, host):
    assert status(server, Host=f"{host}:{port_of(server)}")[0] == 200


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example", "", "a:b:c", "[::1"])
def test_a_strangers_name_is_refused(server, host):
    code, text = status(server, Host=host)
    assert code == 403 and "--allow-origin" in text


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:9"])
def test_a_strangers_page_is_refused(server, origin):
    with pytest.raises(exceptions.InvalidStatus, match="403"):
        asyncio.run(talk(server, Origin=origin))


def test_its_own_page_and_those_that_are_named_are_let_in(server):
    for origin in (server, "https://hub.example.org"):
        assert asyncio.run(talk(server, Origin=origin))
    assert status(server, Host="hub.example.org")[0] == 200


@pytest.mark.parametrize("origin", ["hub.example.org", "https://hub.example.org/", "*", ""])
def test_what_is_no_origin_is_refused(origin):
    with pytest.raises(NavbakeError, match="expected an origin such as https://hub"):
        open_server(port=0, origins=[origin])


def memory(process):
    with open(f"/proc/{process}/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")


async def load_pages(url, count):
    for _ in range(count):
        await talk(url)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_strangers_messages_print_nothing_and_closed_pages_leave_nothing(tmp_path):
    messages = [b"\xff\x00", "text", b"", msgspec.msgpack.encode({"type": "Nothing"})]
    messages += [
        msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": 5, "updates": "no"}),
        zstandard.compress(msgspec.msgpack.encode({"messages": [{"type": "GuiUpdateMessage"}]})),
    ]
    with run_view(str(write_room(tmp_path))) as (process, url):
        for message in messages:
            with suppress(exceptions.ConnectionClosed):
                asyncio.run(talk(url, message))
        with pytest.raises(exceptions.ConnectionClosed):
            asyncio.run(load_with("viser-v0.0.0", url))
        asyncio.run(load_pages(url, 30))
        before = memory(process.pid)
        asyncio.run(load_pages(url, 60))
        grown = memory(process.pid) - before
        process.terminate()
        _, said = process.communicate()
    assert grown / 60 < 60e3, f"{grown / 60 / 1024:.0f} KiB a page"
    assert said == ""
