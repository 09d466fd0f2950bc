"""Images of maps, good and broken: PGM and PNG whose headers lie, and which unpack to too much."""

from __future__ import annotations

import zlib
from functools import cache
from random import Random

import numpy as np

from fuzzing.mutations import TOKENS, cut, mutate_bytes, mutate_text
from navbake.formats.maps.images import encode_pgm, encode_png

SIGNATURE = b"\x89PNG\r\n\x1a\n"
EDGES = (0, 1, 2, 7, 5000, 20_000, 65_536, 2**31 - 1, 2**31, 2**32 - 1)
COLORS = (0, 2, 3, 4, 6, 1, 255)  # what a PNG's pixels are; the last two are none
TEXTS = (b"tEXt", b"zTXt", b"iTXt", b"tRNS", b"PLTE", b"gAMA", b"IDAT", b"IEND", b"fdAT", b"acTL")

Chunk = tuple[bytes, bytes]


def split_png(data: bytes) -> list[Chunk]:
    """The chunks of a good PNG, type and content."""
    place, chunks = len(SIGNATURE), []
    while place < len(data):
        length = int.from_bytes(data[place : place + 4])
        chunks.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + length]))
        place += 12 + length
    return chunks


def join_png(chunks: list[Chunk]) -> bytes:
    """A PNG of chunks, with lengths and checksums that fit."""
    return SIGNATURE + b"".join(
        len(content).to_bytes(4) + kind + content + zlib.crc32(kind + content).to_bytes(4)
        for kind, content in chunks
    )


def header(width: int, height: int, depth: int = 8, color: int = 0) -> Chunk:
    """The chunk that says what the pixels are."""
    return b"IHDR", width.to_bytes(4) + height.to_bytes(4) + bytes([depth, color, 0, 0, 0])


@cache
def bomb(edge: int, color: int) -> bytes:
    """A PNG of zeros: a thousandth of its pixels in bytes."""
    channels = {0: 1, 2: 3, 6: 4}[color]
    rows = zlib.compress(bytes(edge * (1 + edge * channels)), 9)
    return join_png([header(edge, edge, 8, color), (b"IDAT", rows), (b"IEND", b"")])


def mutate_png(data: bytes, rng: Random) -> bytes:
    """A PNG with another size, depth or kind, other chunks, or other bytes."""
    chance = rng.random()
    if chance < 0.002:
        return bomb(*rng.choice(((3000, 2), (5500, 0), (9000, 0), (9000, 6))))
    if chance < 0.2:
        return mutate_bytes(data, rng, rng.choice((0, 8)))
    chunks = split_png(data)
    if chance < 0.6:
        width, height = (int.from_bytes(chunks[0][1][k : k + 4]) for k in (0, 4))
        chunks[0] = header(
            rng.choice((width, *EDGES)), rng.choice((height, *EDGES)),
            rng.choice((1, 2, 4, 8, 8, 16, 0, 255)), rng.choice(COLORS),
        )  # fmt: skip
    else:
        at = rng.randrange(len(chunks))
        kind, content = chunks[at]
        change = rng.randrange(5)
        if change == 0:
            chunks[at] = kind, mutate_bytes(content, rng)
        elif change == 1:
            del chunks[at]
        elif change == 2:
            chunks.insert(at, rng.choice(chunks))
        elif change == 3:
            packed = zlib.compress(bytes(rng.choice((10, 10**6))))
            chunks.insert(at, (rng.choice(TEXTS), rng.choice((b"", b"a\0\0" + packed, b"\0" * 9))))
        else:
            chunks[at] = rng.choice(TEXTS), content
    return cut(join_png(chunks), rng)


@cache
def grey_png(depth: int = 8) -> bytes:
    """A small PNG of all greys."""
    values = np.arange(60, dtype=np.uint8).reshape(6, 10) * 4
    return encode_png(values if depth == 8 else np.stack([values] * 4, axis=-1))


def make_map_image(rng: Random) -> bytes:
    """A PGM or a PNG of a map, broken in most cases."""
    if rng.random() < 0.5:
        good = grey_png(rng.choice((8, 32)))
        return good if rng.random() < 0.3 else mutate_png(good, rng)
    values = np.arange(60, dtype=np.uint8).reshape(6, 10) * 4
    good = encode_pgm(values)
    chance = rng.random()
    if chance < 0.3:
        return good
    if chance < 0.6:
        words = good[:11].split()
        words[rng.randrange(len(words))] = rng.choice((*TOKENS, b"P2", b"P3", b"P6", b"Pf", b"BM"))
        return cut(b"\n".join(words) + b"\n" + good[11:], rng)
    return mutate_text(good, rng) if chance < 0.8 else mutate_bytes(good, rng)
