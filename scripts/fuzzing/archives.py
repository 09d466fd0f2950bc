"""NumPy archives, broken: zip files whose members lie, hold pickles, or unpack to too much."""

from __future__ import annotations

import io
import math
import pickle
import zipfile
from functools import cache
from random import Random
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzing.mutations import cut, mutate_bytes

BOMB = 300 << 20  # what a bomb unpacks to [bytes]
SIZES = (0, 1, 2**31 - 1, 2**31, 2**32 - 1)


class Trap:
    """What must never be unpickled: that would be the end of the process."""

    def __reduce__(self) -> tuple[Any, ...]:
        return exec, ("import os; os._exit(99)",)


def unpack(data: bytes) -> dict[str, bytes]:
    """The members of an archive."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def pack(members: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    """An archive of members."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content, method)
    return packed.getvalue()


def array_bytes(array: NDArray[Any]) -> bytes:
    """An array as a member holds it."""
    file = io.BytesIO()
    np.lib.format.write_array(file, array, allow_pickle=False)
    return file.getvalue()


def claimed_array(shape: str, dtype: str, content: bytes = b"") -> bytes:
    """An array whose header says what there need not be."""
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}"
    text = header.encode() + b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + content


def pickled_array() -> bytes:
    """An array of objects, which only a pickle can hold."""
    return claimed_array("(1,)", "|O", pickle.dumps([Trap()]))


@cache
def _bomb(dtype: str) -> bytes:
    """An array of zeros that unpacks to 300 MiB, packed: about a thousandth of that."""
    count = BOMB // np.dtype(dtype).itemsize
    edge = round(count ** (1 / 3))
    zeros = bytes(edge**3 * np.dtype(dtype).itemsize)
    return pack(
        {"a.npy": claimed_array(f"({edge}, {edge}, {edge})", dtype, zeros)}, zipfile.ZIP_DEFLATED
    )


def mutate_archive(members: dict[str, bytes], rng: Random, changes: int | None = None) -> bytes:
    """An archive with up to three members changed, and now and then other bytes or lengths."""
    members = dict(members)
    if rng.random() < 0.001:  # takes long
        name = rng.choice(list(members))
        data = _bomb(rng.choice(("|u1", "<f8")))
        return data.replace(b"a.npy", name.encode()[:5].ljust(5, b"_"))
    for _ in range(rng.choice((1, 1, 2, 3)) if changes is None else changes):
        _change_member(members, rng)
    data = pack(members, rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))
    chance = rng.random()
    if chance < 0.1:
        return mutate_bytes(data, rng)
    if chance < 0.2:  # the list of members at the end lies about sizes and places
        changed = bytearray(data)
        entry = data.rfind(b"PK\x01\x02")
        at = entry + rng.choice((8, 10, 16, 20, 24, 28, 42))
        changed[at : at + 4] = rng.choice(SIZES).to_bytes(4, "little")
        return bytes(changed)
    return cut(data, rng)


def _change_member(members: dict[str, bytes], rng: Random) -> None:
    if not members:
        return
    name = rng.choice(list(members))
    content = members[name]
    kind = rng.randrange(7)
    if kind == 0:
        del members[name]
    elif kind == 1:
        del members[name]
        members[name.removesuffix(".npy")] = rng.choice((b"", b"hello", content))
    elif kind == 2:
        members[name] = mutate_bytes(content, rng)
    elif kind == 3:  # the header claims another shape or dtype than there is
        old = rng.choice((b"(", b"3", b"4", b"|b1", b"<u2", b"<f8", b"False", b"|u1"))
        new = rng.choice(
            (*(b"9999999999", b"-1", b"|O", b"<c16", b"<M8[s]", b"|V9", b"(((", b"True"),
             *(b"<U9", b">f8", b"|S1000000", b"<U0", b"2147483647, ", b"0, ", b"[" * 200))
        )  # fmt: skip
        members[name] = content.replace(old, new, 1)
    elif kind == 4:
        shape = rng.choice(("(1, 1, 1)", "(2147483647,)", "(9223372036854775807, 3)", "()", "(0,)"))
        dtype = rng.choice(("|b1", "|u1", "<u4", "<f8", "<U4", "|O"))
        members[name] = claimed_array(shape, dtype, content[:64])
    elif kind == 5 and rng.random() < 0.3:
        members[name] = pickled_array()
    else:
        members[name] = array_bytes(_odd_array(rng))


def _odd_array(rng: Random) -> NDArray[Any]:
    shape = tuple(rng.choice((0, 1, 2, 3, 5)) for _ in range(rng.choice((0, 1, 1, 3, 3, 4))))
    dtype = rng.choice(("?", "u1", "u2", "u4", "u8", "i8", "f4", "f8", "c8", "U3", "S2", "M8[s]"))
    floats = (math.inf, math.nan, 1e308, -1e308)
    value = rng.choice((0, 1, 7, *(floats if dtype in ("f4", "f8") else (3,))))
    with np.errstate(over="ignore"):
        return np.full(shape, value).astype(dtype)
