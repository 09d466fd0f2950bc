"""Puts a page together: skeleton, content, and a policy that lets it load nothing."""

import hashlib
import html
import zlib
from base64 import b64encode
from collections.abc import Sequence
from importlib import resources
from string import Template
from typing import Any

import orjson

from navbake.types import Int, Json

KIT = "navbake.views.page"
INSIDE = "data:"  # where pictures may be: in the page itself
MAX_ROWS = 2000  # of a table; the page says how many more there are
LEVEL = 6  # of compression: 9 takes five times as long for 2 % less


def make_page(content: Json, package: str, script: str, pictures: str = INSIDE) -> bytes:
    """The page that shows some content, UTF-8; the same content, the same bytes.

    Its policy (Content-Security-Policy) names the hashes of its script and its style, and forbids
    everything else but pictures. So nothing that a file calls a room can run, and the page asks
    the network for nothing.

    Args:
        content: what its script reads, and its ``title``.
        package: where its ``body.html`` and its script are.
        script: the script's name; ``kit.js`` stands before it.
        pictures: where pictures may come from, as the policy writes it.
    """
    style = _read(KIT, "page.css")
    code = f"{_read(KIT, 'kit.js')}\n{_read(package, script)}"
    packed = orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY)
    page = Template(_read(KIT, "page.html")).substitute(
        PICTURES=pictures,
        STYLE=style,
        STYLE_HASH=_hash(style),
        BODY=_read(package, "body.html"),
        SCRIPT=code,
        SCRIPT_HASH=_hash(code),
        TITLE=html.escape(content["title"]),
        # a "<" could end the element that holds the content
        CONTENT=packed.replace(b"<", b"\\u003c").decode("utf-8"),
    )
    return page.encode("utf-8")


def table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]], numbers: Sequence[int] = ()
) -> Json:
    """A table of a page; `numbers` are the columns that hold some, which stand to the right.

    A column that is empty in all rows is left out.
    """
    kept = [i for i in range(len(columns)) if any(row[i] not in ("", None) for row in rows)]
    shown = rows[:MAX_ROWS]
    return {
        "title": title,
        "columns": [columns[i] for i in kept],
        "rows": [["" if row[i] is None else row[i] for i in kept] for row in shown],
        "numbers": [place for place, i in enumerate(kept) if i in numbers],
        "more": len(rows) - len(shown),
    }


def pack(values: Int) -> Json:
    """Pack whole numbers from -1 to 2**32 - 2 of any shape; `unpack` in ``kit.js`` undoes it.

    Returns:
        ``bytes`` of a number; ``data``: one more than each number, as the difference from the one
        before it, compressed.
    """
    size = next(size for size in (1, 2, 4) if values.max(initial=0) + 1 < 1 << 8 * size)
    stored = (values.ravel() + 1).astype(f"<u{size}")
    stored[1:] -= stored[:-1].copy()  # modulo 2**(8 * size)
    return {"bytes": size, "data": to_text(stored.tobytes())}


def to_text(data: bytes) -> str:
    """Compress bytes into text: zlib, then base64."""
    return b64encode(zlib.compress(data, LEVEL)).decode("ascii")


def _read(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8").strip()


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"sha256-{b64encode(digest).decode('ascii')}"
