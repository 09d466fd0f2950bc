"""Small changes to JSON, text and bytes, drawn at random."""

from __future__ import annotations

import copy
import json
import zlib
from functools import cache
from random import Random
from typing import Any

NUMBERS = (
    *(0, 1, -1, 2, 3, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63, 2**64),
    *(
        10**25,
        -(2**63),
        0.5,
        -0.0,
        1e-9,
        1e-308,
        5e-324,
        1e9,
        1e10,
        1e15,
        1e38,
        1e39,
        1e308,
        -1e308,
    ),
)
WORDS = (
    *("", "x", "0", "-1", "1e999", "nan", "inf", "null", "true", "é", "\0", "\n", "😀", "a" * 300),
    *("../..", "/dev/zero", "name", "level", "open", "closed", "rle", "raw", "uint32", "float64"),
    *("Uint8ClampedArray", "Polygon", "MultiPolygon", "Feature", "auto", "none", "*", "[", "[!"),
)
TOKENS = (
    *(b"0", b"-1", b"1", b"2", b"4294967295", b"99999999999999999999", b"1e308", b"-1e308", b"nan"),
    *(b"inf", b"0.5", b"1e-320", b"", b"x", b"\0", b"#", b"\xff\xfe", b"/", b"-", b"1/2/3", b"\t"),
    *(b"1000000000", b"65536", b"255", b"-2147483649", b"true", b"data", b"end_header", b"<", b"&"),
)


def odd_value(rng: Random) -> Any:
    """A JSON value that a reader may not expect."""
    kind = rng.randrange(6)
    if kind < 2:
        return rng.choice(NUMBERS)
    if kind < 4:
        return rng.choice(WORDS)
    return copy.deepcopy(
        rng.choice((None, True, False, [], {}, [[]], [None], {"a": {}}, [1, 2], [0, 0, 0], [["a"]]))
    )


def mutate_tree(tree: Any, rng: Random) -> Any:
    """A JSON value with up to six changes; the one given is not changed."""
    holder = [copy.deepcopy(tree)]
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        parent, key = _pick(holder, rng)
        kind = rng.randrange(9)
        if kind < 4:
            parent[key] = odd_value(rng)
        elif kind == 4 and parent is not holder:
            del parent[key]
        elif kind == 5:
            other, place = _pick(holder, rng)
            parent[key] = copy.deepcopy(other[place])
        elif kind == 6:
            parent[key] = [parent[key]] * rng.choice((1, 2, 5))
        elif kind == 7 and isinstance(parent, dict):
            parent[rng.choice(WORDS)] = parent.pop(key)
        elif kind == 8 and isinstance(parent, list) and parent is not holder:
            parent.insert(rng.randrange(len(parent) + 1), odd_value(rng))
    return holder[0]


def dump_tree(tree: Any, rng: Random) -> bytes:
    """A value as JSON, now and then with NaN, broken bytes or nesting that no reader follows."""
    text = json.dumps(tree, ensure_ascii=rng.random() < 0.5).encode(errors="surrogatepass")
    chance = rng.random()
    if chance < 0.08:
        return mutate_bytes(text, rng)
    if chance < 0.1:
        depth = rng.choice((100, 2000, 100_000))
        return text.replace(rng.choice((b"0", b"1", b"null", b"{}")), b"[" * depth, 1)
    return text


def mutate_bytes(data: bytes, rng: Random, begin: int = 0) -> bytes:
    """Bytes with up to eight changed, removed, doubled or inserted, from `begin` on."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 8))):
        if len(changed) <= begin:
            break
        at = rng.randrange(begin, len(changed))
        kind = rng.randrange(6)
        if kind == 0:
            changed[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            changed[at] = rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))
        elif kind == 2:
            del changed[at : at + rng.choice((1, 1, 4, 50))]
        elif kind == 3:
            changed[at:at] = rng.choice(TOKENS)
        elif kind == 4:
            changed[at:at] = changed[at : at + rng.choice((1, 4, 50))]
        else:
            changed[at : at + 4] = rng.choice(
                (b"\xff\xff\xff\xff", b"\0\0\0\0", b"\xff\xff\xff\x7f")
            )
    return bytes(changed)


def mutate_text(text: bytes, rng: Random, separators: bytes = b" \n") -> bytes:
    """Text with words changed, lines removed, doubled or swapped; now and then any bytes."""
    if rng.random() < 0.15:
        return mutate_bytes(text, rng)
    for _ in range(rng.choice((1, 1, 2, 3, 6))):
        separator = bytes([rng.choice(separators)])
        parts = text.split(separator)
        at = rng.randrange(len(parts))
        kind = rng.randrange(5)
        if kind < 2:
            parts[at] = rng.choice(TOKENS)
        elif kind == 2:
            del parts[at]
        elif kind == 3:
            parts.insert(at, parts[rng.randrange(len(parts))])
        else:
            other = rng.randrange(len(parts))
            parts[at], parts[other] = parts[other], parts[at]
        text = separator.join(parts)
    return text


def _pick(holder: list[Any], rng: Random) -> tuple[Any, Any]:
    """A place in a tree, as what holds it and its key; all depths are met."""
    parent: Any = holder
    key: Any = 0
    while True:
        value = parent[key]
        keys = (
            list(value)
            if isinstance(value, dict)
            else range(len(value))
            if isinstance(value, list)
            else ()
        )
        if not keys or rng.random() < 0.15:
            return parent, key
        parent, key = value, rng.choice(keys)


def cut(data: bytes, rng: Random) -> bytes:
    """The bytes; one in twenty times they end early."""
    return data if rng.random() < 0.95 else data[: rng.randrange(len(data) + 1)]


def gzip_bomb(begin: bytes, rng: Random) -> bytes:
    """Few bytes that unpack to many, which begin as the format does."""
    return _gzip_bomb(begin, rng.choice((1 << 20, 30 << 20, 300 << 20)))


@cache
def _gzip_bomb(begin: bytes, size: int) -> bytes:
    pack = zlib.compressobj(9, wbits=31)
    pieces = [pack.compress(begin), *(pack.compress(b" " * (1 << 20)) for _ in range(size >> 20))]
    return b"".join(pieces) + pack.flush()
