"""The page answers those who name its address and come from it, and nobody else."""

import asyncio
import http.client
import socket
from urllib.parse import urlsplit

import pytest

pytest.importorskip("viser")
import viser
import websockets

from navbake.errors import NavbakeError
from navbake.views.viewer.server import PageServer

LAB = "https://lab.example.org"


@pytest.fixture(scope="module")
def server():
    server = PageServer(port=0, allowed=[LAB])
    server.title = "a <b> – navbake"
    yield server
    server.close()


def ask(server, path="/", **headers):
    """Status and content of an answer; the Host is the page's unless another is given."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    return answer.status, answer.read()


def test_the_page_has_its_title(server):
    status, page = ask(server)
    assert status == 200 and b"<title>a &lt;b&gt; \xe2\x80\x93 navbake</title>" in page
    assert server.url == f"http://127.0.0.1:{server.port}"
    assert ask(server, "/none.png")[0] == 404
    assert ask(server, "/../../etc/passwd")[0] == 404


@pytest.mark.parametrize("host", ["127.0.0.1:{}", "localhost:{}", "lab.example.org"])
def test_its_own_address_is_answered(server, host):
    assert ask(server, Host=host.format(server.port))[0] == 200


STRANGE = ["127.0.0.1", "127.0.0.1:1", "evil.example:{}", "127.0.0.1.evil.example:{}", "", "a:b:c"]


@pytest.mark.parametrize("host", STRANGE)
def test_another_host_is_refused(server, host):
    assert ask(server, Host=host.format(server.port))[0] == 403


@pytest.mark.parametrize(
    ("origin", "status"),
    [("http://127.0.0.1:{}", 200), (LAB, 200), ("http://evil.example", 403), ("null", 403),
     ("http://localhost:{}", 403), ("http://127.0.0.1:1", 403)],
)  # fmt: skip
def test_pages_of_other_sites_are_refused(server, origin, status):
    assert ask(server, Origin=origin.format(server.port))[0] == status


def connect(url, origin=None):
    async def run():
        version = f"viser-v{viser.__version__}"
        async with websockets.connect(url, origin=origin, subprotocols=[version]) as socket:
            return len(await socket.recv())

    return asyncio.run(run())


def test_websockets_are_checked_too(server):
    url = server.url.replace("http", "ws")
    assert connect(url, server.url) > 0 and connect(url, LAB) > 0
    with pytest.raises(websockets.exceptions.InvalidStatus, match="403"):
        connect(url, "http://evil.example")


@pytest.mark.parametrize("sent", [b"", b"\r\n\r\n", b"GET / HTTP/1.1\r\n\r\n", b"\0" * 100_000])
def test_what_is_no_request_ends_alone(server, sent, capfd):
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as other:
        other.sendall(sent)
        other.shutdown(socket.SHUT_WR)
        assert b"200" not in other.recv(100)
    assert ask(server)[0] == 200
    assert "Traceback" not in capfd.readouterr().err


def test_a_strangers_message_prints_no_traceback(server, capfd):
    async def send():
        version = f"viser-v{viser.__version__}"
        url = server.url.replace("http", "ws")
        async with websockets.connect(url, subprotocols=[version]) as socket:
            await socket.send(b"\xff\0 nonsense")
            await socket.send("text")
            await asyncio.sleep(0.5)

    asyncio.run(send())
    assert ask(server)[0] == 200
    assert "Traceback" not in capfd.readouterr().err


def test_where_all_addresses_are_served_names_are_still_checked():
    server = PageServer("0.0.0.0", 0)
    try:
        assert server.url == f"http://localhost:{server.port}"
        own = socket.gethostname()
        for host, status in (("10.1.2.3", 200), (own, 200), ("evil.example", 403)):
            assert ask(server, Host=f"{host}:{server.port}")[0] == status
    finally:
        server.close()
    with socket.socket() as again:
        again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        again.bind(("127.0.0.1", urlsplit(server.url).port))


@pytest.mark.parametrize("origin", ["lab.example.org", "https://lab.example.org/", "*", "ftp://a"])
def test_what_is_no_origin_is_named(origin):
    with pytest.raises(NavbakeError, match=r"expected an origin like .*, got '"):
        PageServer(port=0, allowed=[origin])
