"""Makes HTML pages from a body, a common style, scripts and compressed content.

A page needs neither a server nor the network. The script ``kit.js`` decompresses the content.
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

DATA_URLS = "data:"  # source of pictures in a page's policy: the page itself has them
MAX_TABLE_ROWS = 2000  # most rows of a table that a page shows; it says how many more there are
COMPRESSION_LEVEL = 6  # of zlib; level 9 takes five times as long and saves 2 %


def make_page(
    title: str, content: Json, package: str, file_stem: str, picture_sources: str = DATA_URLS
) -> bytes:
    """Make an HTML page. Equal arguments give equal bytes.

    The page's policy (Content-Security-Policy) allows only its own script and style, by their
    hashes, and pictures. So no name from a file can run as a script, and the page loads nothing
    from the network.

    Args:
        title: the title of the page, as plain text.
        content: the JSON that the script reads; it may contain numpy arrays.
        package: the package that has the files of the page.
        file_stem: the name of the page's files without ending: the body ends in ``.html``, the
            script in ``.js``.
        picture_sources: the sources from which pictures may be loaded, in the policy's syntax.

    Returns:
        The HTML, UTF-8.
    """

    def read_text(package: str, file_name: str) -> str:
        return resources.files(package).joinpath(file_name).read_text(encoding="utf-8").strip()

    style = read_text(__package__, "page.css")
    script = f"{read_text(__package__, 'kit.js')}\n{read_text(package, f'{file_stem}.js')}"
    hashes = [
        b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in (style, script)
    ]
    content_json = orjson.dumps({"title": title, **content}, option=orjson.OPT_SERIALIZE_NUMPY)
    page_html = Template(read_text(__package__, "page.html")).substitute(
        PICTURES=picture_sources,
        STYLE=style,
        STYLE_HASH=f"sha256-{hashes[0]}",
        BODY=read_text(package, f"{file_stem}.html"),
        SCRIPT=script,
        SCRIPT_HASH=f"sha256-{hashes[1]}",
        TITLE=html.escape(title),
        # a "<" could end the element that holds the content
        CONTENT=content_json.replace(b"<", b"\\u003c").decode("utf-8"),
    )
    return page_html.encode("utf-8")


def describe_table(title: str, table: Table, *, is_folded: bool = False) -> Json:
    """Describe a table for a page, without the columns that are empty in all rows.

    Args:
        title: the title over the table.
        table: the table, whose first `MAX_TABLE_ROWS` rows are shown.
        is_folded: whether only the table's title shows until the user opens it.

    Returns:
        JSON that the page's script reads.
    """
    table = table.without_empty_columns()
    return {
        "title": title,
        "folded": is_folded,
        "columns": table.headings,
        "rows": table.rows[:MAX_TABLE_ROWS],
        "numbers": [i for i, heading in enumerate(table.headings) if heading in table.numbers],
        "more": max(0, len(table.rows) - MAX_TABLE_ROWS),
    }


def pack_json(json_content: Json) -> str:
    """Compress JSON, which may contain numpy arrays, into text, see `compress_to_text`."""
    return compress_to_text(orjson.dumps(json_content, option=orjson.OPT_SERIALIZE_NUMPY))


def compress_to_text(json_bytes: bytes) -> str:
    """Compress JSON (UTF-8) into text: zlib, then base64; ``unpack`` in ``kit.js`` undoes this."""
    return b64encode(zlib.compress(json_bytes, COMPRESSION_LEVEL)).decode("ascii")
