"""Puts the page together: its parts, its content, and a policy that lets it load nothing."""

import hashlib
import html
from base64 import b64encode
from collections.abc import Sequence
from importlib import resources
from string import Template

import orjson

from navbake.types import Json

HERE = "navbake.views.report"


def make_page(content: Json, package: str = HERE, scripts: Sequence[str] = ("page.js",)) -> bytes:
    """The page that shows some content, UTF-8; the same content, the same bytes.

    Args:
        content: what its script reads, and its ``title``.
        package: where ``page.html``, ``page.css`` and the scripts are.
        scripts: their names; they become one.

    Its policy (Content-Security-Policy) names the hashes of its script and its style, and forbids
    everything else but pictures that are inside. So nothing that a file calls a room can run, and
    the page asks the network for nothing.
    """
    style = _read(package, "page.css")
    script = "\n".join(_read(package, name) for name in scripts)
    packed = orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY)
    # a "<" could end the element that holds the content
    stated = packed.replace(b"<", b"\\u003c").decode("utf-8")
    page = Template(_read(package, "page.html")).substitute(
        STYLE=style,
        SCRIPT=script,
        STYLE_HASH=_hash(style),
        SCRIPT_HASH=_hash(script),
        TITLE=html.escape(content["title"]),
        CONTENT=stated,
    )
    return page.encode("utf-8")


def _read(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8").strip()


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"sha256-{b64encode(digest).decode('ascii')}"
