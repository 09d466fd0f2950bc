"""Voxels: binvox, octrees, NumPy archives, and the tables of their IDs."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from random import Random

import numpy as np

from fuzzing.archives import mutate_archive, unpack
from fuzzing.kind import Input, attempt, is_one_in
from fuzzing.mutations import cut, dump_tree, mutate_bytes, mutate_text, mutate_tree
from navbake.formats.binvox import encode_binvox, read_binvox
from navbake.formats.npz import encode_npz, read_npz
from navbake.formats.octomap import encode_octomap
from navbake.formats.voxels import read_voxels
from navbake.voxels.grid import VoxelGrid

FEW_VOXELS = 4_000_000


@cache
def _voxels() -> tuple[VoxelGrid, ...]:
    rng = np.random.default_rng(0)
    plain = VoxelGrid(values=rng.random((4, 3, 5)) < 0.4, origin=(0.0, -0.5, 1.0), res=0.5)
    ids = rng.integers(0, 4, (3, 4, 2)).astype(np.uint16)
    known = rng.random((3, 4, 2)) < 0.8
    named = VoxelGrid(
        values=ids, origin=(0.0, 0.0, 0.0), res=0.25, names={1: "a", 2: "é", 3: "c"}, known=known
    )
    return plain, named


def make_binvox(rng: Random) -> Input:
    """A binvox file with other words in its header, other runs, or other bytes."""
    grid = rng.choice(_voxels())
    data = encode_binvox(grid, rng.choice(("binvox", "airsim")))
    header, mark, runs = data.partition(b"data\n")
    kind = rng.randrange(4)
    if kind < 2:
        header = mutate_text(header, rng)
    if kind == 1 or kind == 2:
        runs = mutate_bytes(runs, rng)
    if kind == 3:  # a header that fits other runs
        dim = [rng.choice((1, 2, 7, 300, 70_000, 2**31, 2**40)) for _ in range(3)]
        header = b"#binvox 1\ndim %d %d %d\n" % tuple(dim)
        runs = b"\x01\xff" * rng.choice((1, 100, 50_000))
    return Input(cut(header + mark + runs, rng), ".binvox")


@cache
def _octree(number: int, kind: str, free: bool) -> bytes:
    return encode_octomap(_voxels()[number], kind, free=free)


def make_octree(kind: str, rng: Random) -> Input:
    """An octree with flipped bits in its nodes, or other words in its header."""
    data = _octree(rng.randrange(2), kind, rng.random() < 0.5)
    begin = data.index(b"data\n") + 5
    chance = rng.random()
    if chance < 0.25:
        data = mutate_text(data[:begin], rng) + data[begin:]
    elif chance < 0.5:  # the tree stays whole: only what its leaves are changes
        changed = bytearray(data)
        for _ in range(rng.choice((1, 2, 5))):
            changed[rng.randrange(begin, len(data))] ^= 1 << rng.randrange(8)
        data = bytes(changed)
    elif chance < 0.75:
        words = [rng.choice((0, 1, 2, 3, 0x5555, 0xAAAA, 0xFFFF, rng.randrange(65536)))]
        words *= rng.choice((1, 16, 400))
        data = data[:begin] + b"".join(w.to_bytes(2, "little") for w in words)
    else:
        data = mutate_bytes(data, rng, begin)
    return Input(cut(data, rng), f".{kind}")


def make_npz(rng: Random) -> Input:
    """An archive with arrays of other shapes and dtypes, members that are none, other bytes."""
    data = encode_npz(rng.choice(_voxels()))
    if rng.random() < 0.2:
        return Input(mutate_bytes(data, rng), ".npz")
    return Input(mutate_archive(unpack(data), rng), ".npz")


def make_names(rng: Random) -> Input:
    """Voxels with a table of IDs beside them that has changes in its JSON."""
    table = {"rule": "0 is empty", "ids": {"1": "a", "2": "b", "3": "é"}}
    text = dump_tree(mutate_tree(table, rng), rng)
    return Input(encode_binvox(_voxels()[1]), ".binvox", {"input.binvox.names.json": text})


def read_some(path: Path) -> VoxelGrid:
    """Read voxels. Some may fill what the file's size allows; for most that takes too long."""
    return read_voxels(path, max_voxels=None if is_one_in(50, path.read_bytes()) else FEW_VOXELS)


def read_twice(path: Path) -> VoxelGrid:
    """Read a binvox file in both of its layouts."""
    attempt(lambda: read_binvox(path, layout="airsim", max_voxels=FEW_VOXELS))
    return read_some(path)


def check_voxels(grid: VoxelGrid) -> None:
    """Ask for what voxels hold, and write them."""
    _ = grid.bounds, grid.ids()
    attempt(lambda: grid.at(grid.bounds.mean(axis=0)))
    if grid.values.size > 1_000_000:
        return
    attempt(lambda: encode_binvox(grid))
    attempt(lambda: _check_same(grid))
    if is_one_in(20, grid.values.tobytes()):  # slow, in parallel
        attempt(lambda: encode_octomap(grid, "bt"))


def _check_same(grid: VoxelGrid) -> None:
    again = read_npz(encode_npz(grid))
    known = grid.known is None or np.array_equal(grid.known, again.known)
    is_same = known and grid.names == again.names and grid.origin == again.origin
    if not is_same or not np.array_equal(grid.values, again.values) or grid.res != again.res:
        raise AssertionError("voxels are others after they are written and read")
