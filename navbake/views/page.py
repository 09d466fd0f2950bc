"""What pages are made of: a skeleton, one style, functions that scripts share, and packed content.

A page needs neither a server nor the network. `kit.js` unpacks what is packed here.
"""

import hashlib
import html
import zlib
from base64 import b64encode
from importlib import resources
from string import Template

import orjson

from navbake.types import Json
from navbake.views.tables import Table

INSIDE = "data:"  # where pictures may be: in the page itself
MAX_ROWS = 2000  # of a table; the page says how many more there are
LEVEL = 6  # of compression: 9 takes five times as long for 2 % less


def make_page(title: str, content: Json, package: str, name: str, pictures: str = INSIDE) -> bytes:
    """The page that shows some content, UTF-8; the same content, the same bytes.

    Its body, ``name.html``, and its script, ``name.js``, are in `package`; the script reads the
    content. Its policy (Content-Security-Policy) names the hashes of its script and its style, and
    forbids everything else but pictures from `pictures`. So nothing that a file calls a room can
    run, and the page asks the network for nothing.
    """

    def read(package: str, name: str) -> str:
        return resources.files(package).joinpath(name).read_text(encoding="utf-8").strip()

    style = read(__package__, "page.css")
    code = f"{read(__package__, 'kit.js')}\n{read(package, f'{name}.js')}"
    hashes = [b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in (style, code)]
    packed = orjson.dumps({"title": title, **content}, option=orjson.OPT_SERIALIZE_NUMPY)
    page = Template(read(__package__, "page.html")).substitute(
        PICTURES=pictures,
        STYLE=style,
        STYLE_HASH=f"sha256-{hashes[0]}",
        BODY=read(package, f"{name}.html"),
        SCRIPT=code,
        SCRIPT_HASH=f"sha256-{hashes[1]}",
        TITLE=html.escape(title),
        # a "<" could end the element that holds the content
        CONTENT=packed.replace(b"<", b"\\u003c").decode("utf-8"),
    )
    return page.encode("utf-8")


def show_table(title: str, table: Table, *, folded: bool = False) -> Json:
    """A table of a page, without the columns that are empty in all rows."""
    shown = table.without_empty_columns()
    return {
        "title": title,
        "folded": folded,
        "columns": shown.headings,
        "rows": shown.rows[:MAX_ROWS],
        "numbers": [i for i, heading in enumerate(shown.headings) if heading in table.numbers],
        "more": max(0, len(shown.rows) - MAX_ROWS),
    }


def pack(content: Json) -> str:
    """Pack JSON with arrays, as `to_text`."""
    return to_text(orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY))


def to_text(data: bytes) -> str:
    """Compress JSON into text: zlib, then base64; `unpack` in ``kit.js`` undoes it."""
    return b64encode(zlib.compress(data, LEVEL)).decode("ascii")
