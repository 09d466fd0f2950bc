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


STRANGE = [
    "127.0.0.1", "127.0.0.1:1", "evil.example:{}", "127.0.0.1.evil.example:{}", "", "a:b:c",
    "evil.example@127.0.0.1:{}", "evil.example:1@localhost:{}", "127.0.0.1:{}/evil.example",
    "127.0.0.1:{}?evil.example", "127.0.0.1:{}#evil", "127.0.0.1:{} evil.example", "127.0.0.1:{}0",
    "127.0.0.1:0{}", "evil.localhost:{}", "localhost.:{}", "lab.example.org.evil.example",
    "lab.example.org@evil.example", "evil-lab.example.org", "lab.example.org:8443",
]  # fmt: skip


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


def ask_raw(server, path, *lines):
    """Head of the answer to a request whose head has these lines."""
    host = f"Host: 127.0.0.1:{server.port}"
    request = "\r\n".join([f"GET {path} HTTP/1.1", host, *lines, "Connection: close", "", ""])
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as client:
        client.sendall(request.encode())
        answer = b"".join(iter(lambda: client.recv(1 << 16), b""))
    return answer.partition(b"\r\n\r\n")[0].decode()


IMAGE = "Sec-Fetch-Mode: no-cors", "Sec-Fetch-Dest: image"
LINK = "Sec-Fetch-Mode: navigate", "Sec-Fetch-Dest: document"
FRAME = "Sec-Fetch-Mode: navigate", "Sec-Fetch-Dest: iframe"


@pytest.mark.parametrize(
    ("path", "lines", "status"),
    [
        ("/none.png", ("Sec-Fetch-Site: cross-site", *IMAGE), 403),
        ("/none.png", ("Sec-Fetch-Site: same-site", *IMAGE), 403),  # another port of this machine
        ("/none.png", ("Sec-Fetch-Site: cross-site", *LINK), 403),
        ("/none.png", ("Sec-Fetch-Site: none", "Sec-Fetch-Site: cross-site"), 403),
        ("/none.png", ("Sec-Fetch-Site: same-origin", *IMAGE), 404),
        ("/", ("Sec-Fetch-Site: none", *LINK), 200),
        ("/", ("Sec-Fetch-Site: cross-site", *LINK), 200),  # a link in a mail
        ("/?a=b", ("Sec-Fetch-Site: cross-site", *LINK), 200),
        ("/", ("Sec-Fetch-Site: cross-site", *FRAME), 403),
        ("/", ("Sec-Fetch-Site: cross-site",), 403),
        ("/", ("Sec-Fetch-Site: cross-site", f"Origin: {LAB}"), 200),
        ("/", (), 200),  # no browser, or an old one
    ],
)
def test_requests_of_other_sites_without_an_origin_are_refused(server, path, lines, status):
    assert ask_raw(server, path, *lines).startswith(f"HTTP/1.1 {status} ")


@pytest.mark.parametrize("path", ["/", "/?a=b", "/index.html", "/./", "/none.png"])
def test_no_answer_may_stand_in_a_frame(server, path):
    head = ask_raw(server, path)
    assert head.count("Content-Security-Policy: frame-ancestors 'none'") == 1


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
