"""Maps of other programs: ROS and nav2, ProcTHORMap, map descriptors, what is explored."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import navbake
from fuzzing import texts
from fuzzing.archives import array_bytes, claimed_array, pickled_array
from fuzzing.images import join_png, make_map_image, mutate_png, split_png
from fuzzing.kind import Input
from fuzzing.mutations import WORDS, cut, dump_tree, mutate_bytes, mutate_tree, odd_value
from navbake.arena import map_descriptor
from navbake.errors import FormatError
from navbake.formats.maps.procthor import encode_procthor

NAV2: dict[str, Any] = {
    "image": "map.pgm", "resolution": 0.05, "origin": [-1.0, 2.0, 0.0], "negate": 0,
    "occupied_thresh": 0.65, "free_thresh": 0.25, "mode": "trinary", "navbake": {"ground": 0.5},
}  # fmt: skip
IMAGES = ("map.pgm", "map.pgm", "map.pgm", "no.pgm", ".", "/dev/zero", "input.yaml", "a" * 300)
NUMBERS = (0, -1, 0.1, 1, 1e-9, 1e-10, 1e10, 1e308, 2**63, "nan", ".inf", "1e999", 0.5, 90, -3.2)


def make_nav2(rng: Random) -> Input:
    """A map's YAML with other values, and an image that may be broken."""
    entries = {**NAV2, "mode": rng.choice(("trinary", "scale", "raw"))}
    entries["negate"] = rng.choice((0, 1, "yes", True))
    yaw = rng.choice((0.0, 0.0, 1.5707963, 3.14159, 0.3, -7.5, 1e-9))
    entries["origin"] = [rng.choice((-1.0, 0, 3.5)), 2.0, yaw]
    lines = [f"{key}: {json.dumps(value)}" for key, value in entries.items()]
    for _ in range(rng.choice((0, 0, 1, 1, 2))):
        at = rng.randrange(len(lines))
        key = lines[at].partition(":")[0]
        if key == "image":
            value: Any = rng.choice(IMAGES)
        elif key == "origin":
            value = [rng.choice(NUMBERS) for _ in range(rng.choice((3, 3, 3, 2, 0, 4)))]
        else:
            value = rng.choice((*NUMBERS, *texts.SCALARS, odd_value(rng)))
        lines[at] = f"{key}: {value}"
    data = "\n".join(lines).encode(errors="surrogatepass")
    data = mutate_bytes(data, rng) if rng.random() < 0.05 else cut(data, rng)
    return Input(data, ".yaml", {"map.pgm": make_map_image(rng)})


@cache
def _procthor() -> tuple[bytes, ...]:
    files = [
        encode_procthor(navbake.load(json.dumps(tree).encode()), Path("a.png"))
        for tree in texts.GRIDS
    ]
    return tuple(b"".join(content) if not isinstance(content, bytes) else content
                 for each in files for content in each.values())  # fmt: skip


def make_procthor(rng: Random) -> Input:
    """A ProcTHORMap with changes in the JSON of its texts, or in its image."""
    data = rng.choice(_procthor())
    if rng.random() < 0.4:
        return Input(mutate_png(data, rng), ".png")
    chunks = split_png(data)
    at = rng.choice([k for k, (kind, _) in enumerate(chunks) if kind in (b"tEXt", b"zTXt")])
    name, _, text = chunks[at][1].partition(b"\0")
    if rng.random() < 0.1:
        name = rng.choice(WORDS).encode("latin-1", errors="replace")[:79] or b"x"
    changed = dump_tree(mutate_tree(json.loads(text), rng), rng)
    chunks[at] = chunks[at][0], name + b"\0" + changed
    return Input(join_png(chunks), ".png")


def make_descriptor(rng: Random) -> Input:
    """Both parts of a map descriptor, with changes, and a shape."""
    shape: Any = rng.choice(((20, 15), (20, 15), (3, 5), (1, 1)))
    known = np.array([[rng.random() < 0.7 for _ in range(shape[1])] for _ in range(shape[0])])
    parts: list[Any] = list(map_descriptor.encode(known, known[::-1]))
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(2)
        text = parts[at] if isinstance(parts[at], str) else ""
        kind = rng.randrange(5)
        if kind == 0 and text:
            place = rng.randrange(len(text))
            parts[at] = text[:place] + rng.choice("0123456789abcdefFxg ٣\0") + text[place + 1 :]
        elif kind == 1:
            parts[at] = text[: rng.randrange(len(text) + 1)]
        elif kind == 2:
            parts[at] = text + rng.choice(("0", "00", "F", " ", "\n", "0" * 100_000))
        elif kind == 3:
            parts[at] = odd_value(rng)
        else:
            shape = rng.choice(
                ((0, 1), (-1, 5), (10**6, 10**6), (1.5, 2), (20,), "ab", 5, (True, 9), (10**4,) * 2)
            )
    return Input(json.dumps([parts, shape]).encode(), ".json")


def read_descriptor(path: Path) -> Sequence[Any]:
    """Decode a descriptor; its parts and its shape are in a list."""
    try:
        (part1, part2), shape = json.loads(path.read_bytes())
    except (ValueError, TypeError) as error:
        raise FormatError("no list of two parts and a shape") from error
    return map_descriptor.decode(part1, part2, shape)


def check_descriptor(decoded: Sequence[Any]) -> None:
    """Encode a map, decode it again, and draw it."""
    parts = map_descriptor.encode(*decoded)
    if not np.array_equal(map_descriptor.decode(*parts, decoded[0].shape), decoded):
        raise AssertionError("a map is another one after it is written and read")
    map_descriptor.draw(*decoded)


def make_explored(rng: Random) -> Input:
    """An array with another header than it has data, a pickle, or other bytes."""
    good = array_bytes(np.ones((4, 3), dtype=rng.choice(("?", "u1", "f4"))))
    kind = rng.randrange(5)
    if kind == 0:
        return Input(pickled_array(), ".npy")
    if kind == 1:
        shape = rng.choice(("(2147483647, 9)", "(-1, 3)", "()", "(0, 0)", "(9223372036854775807,)"))
        dtype = rng.choice(("|b1", "<f8", "|O", "|S2147483647", "<U9", "|V0", "<M8[s]"))
        return Input(cut(claimed_array(shape, dtype, bytes(12)), rng), ".npy")
    if kind == 2:
        words = (b"(", b"{", b"'descr'", b"True", b"False", b"3", b"|b1", b"<f4")
        odd = (b"", b"9" * 30, b"-1", b"(" * 300, b"\xff", b"None", b"lambda: 1", b"|O")
        return Input(good.replace(rng.choice(words), rng.choice(odd), 1), ".npy")
    return Input(cut(mutate_bytes(good, rng), rng), ".npy")
