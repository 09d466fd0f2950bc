"""OctoMap trees: voxels as octrees, ``.bt`` (occupied, free, unknown) and ``.ot`` (log-odds).

A tree has depth 16; a voxel's key is ``floor(coordinate / res) + 32768`` along each axis. So the
corners of voxels are multiples of `res`, at most 32768 of them from the world's origin.
Children that are equal are pruned. Files are the same, byte for byte, as OctoMap's own.

They are built bottom up: a pyramid holds the state of each node over the grid, level by level, 0
the voxels, 16 the root. Then the nodes are sorted as a walk depth first meets them, which is the
order of the Morton codes of their lowest voxels.

Source: OctoMap 1.9 (`AbstractOcTree.cpp`, `OccupancyOcTreeBase.hxx`, `OcTreeBaseImpl.hxx`): the
header's lines, the order of the nodes, pruning, and the log-odds of what is certain; Morton, A
computer oriented geodetic data base, 1966.
"""

import math
from os import PathLike
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import FormatError
from navbake.formats.allowance import Allowance, JsonPath
from navbake.formats.binvox import read_header
from navbake.formats.source import read_bytes
from navbake.types import Int, Int32
from navbake.voxels.grid import VoxelGrid
from navbake.voxels.placement import finite_array

MAGIC = b"# Octomap OcTree"
DEPTH = 16
CENTER = 2 ** (DEPTH - 1)  # key of the world's origin
FIRST_LINES = {"bt": "# Octomap OcTree binary file", "ot": "# Octomap OcTree file"}
COMMENT = "# (feel free to add / change comments, but leave the first line as it is!)\n#"
OFF = 1e-3  # of a voxel: what a grid may lie off the tree's lattice
LEAF_BYTES = 20  # of a leaf in memory

# States of nodes, as bits: what eight children are together is their bitwise or. MIXED nodes have
# children that differ, MIXED_FREE ones none that is occupied.
UNKNOWN, FREE, OCCUPIED, MIXED_FREE, MIXED = 1, 2, 4, 8, 16
OF_CHILDREN = np.array(
    [c if c in (UNKNOWN, FREE, OCCUPIED) else MIXED if c & (OCCUPIED | MIXED) else MIXED_FREE
     for c in range(32)],
    dtype=np.uint8,
)  # fmt: skip
CHILDREN = [(child & 1, child >> 1 & 1, child >> 2) for child in range(8)]  # x, y, z
# puts two bits between each two of 16, for Morton codes
SPREAD = ((16, 0xFF0000FF), (8, 0xF00F00F00F), (4, 0xC30C30C30C3), (2, 0x249249249249))
TWO_BITS = np.zeros(32, dtype=np.int64)  # of a child in a .bt
TWO_BITS[[FREE, OCCUPIED, MIXED_FREE, MIXED]] = 1, 2, 3, 3

# OctoMap's clamping thresholds: the log-odds of what is certainly free or occupied
FREE_ODDS, OCCUPIED_ODDS = (math.log(p / (1 - p)) for p in (0.1192, 0.971))

Pyramid = list[NDArray[np.uint8]]
Box = tuple[Int, tuple[int, int, int]]  # first key along each axis, and counts of voxels


def encode_octomap(grid: VoxelGrid, kind: str, *, free: bool = False) -> bytes:
    """Encode an octree.

    Args:
        grid: the voxels; IDs count as occupied. It must lie on whole multiples of its edge.
        kind: ``bt`` or ``ot``.
        free: voxels that are known and not occupied are free; else they are unknown.

    Raises:
        FormatError: the grid doesn't lie on the tree's lattice, or reaches beyond it.
    """
    if kind not in FIRST_LINES:
        raise FormatError(f"expected an octree as bt or ot, got {kind!r}")
    first = _first_key(grid)
    pyramid = _build_pyramid(grid, first, free)
    nodes, num_nodes = (_pack_bits if kind == "bt" else _pack_odds)(pyramid, first)
    header = (
        f"{FIRST_LINES[kind]}\n{COMMENT}\nid OcTree\nsize {num_nodes}\n"
        f"res {_text(grid.res)}\ndata\n"
    )
    return header.encode() + nodes


def _build_pyramid(grid: VoxelGrid, first: Int, free: bool) -> Pyramid:
    """The states of all nodes over the grid, from the voxels up to the root.

    Arrays of a level begin at its own first node, ``first >> level``.
    """
    states = np.where(grid.occupied, np.uint8(OCCUPIED), np.uint8(UNKNOWN))
    if free:
        known = True if grid.known is None else grid.known
        states[(states == UNKNOWN) & known] = FREE
    pyramid = [states]
    for level in range(DEPTH):
        begin = first >> level
        even = [(int(k & 1), int(k + n & 1)) for k, n in zip(begin, states.shape, strict=True)]
        states = np.pad(states, even, constant_values=UNKNOWN)
        states = states[0::2] | states[1::2]
        states = states[:, 0::2] | states[:, 1::2]
        states = OF_CHILDREN[states[:, :, 0::2] | states[:, :, 1::2]]
        pyramid.append(states)
    return pyramid


def _child_states(pyramid: Pyramid, first: Int, level: int, nodes: Int) -> Int:
    """The states of the eight children of nodes, which are indices of a level; shape (8, n)."""
    below = np.pad(pyramid[level - 1], 1, constant_values=UNKNOWN)
    lowest = 2 * (nodes + (first >> level)) - (first >> (level - 1)) + 1
    return np.array([below[tuple((lowest + child).T)] for child in CHILDREN])


def _order(keys: list[Int], level_of: list[int]) -> Int:
    """The order in which a walk depth first meets nodes of some keys, listed level by level."""
    codes = []
    for key, level in zip(keys, level_of, strict=True):
        lowest = key << level
        for shift, mask in SPREAD:
            lowest = (lowest | lowest << shift) & mask
        code = lowest[:, 0] | lowest[:, 1] << 1 | lowest[:, 2] << 2
        codes.append(code << 5 | DEPTH - level)  # a parent comes before its first child
    return np.argsort(np.concatenate(codes))


def _pack_bits(pyramid: Pyramid, first: Int) -> tuple[bytes, int]:
    """The nodes of a ``.bt``: two bits for each child, two bytes for each node with children."""
    words, keys, num_nodes = [], [], 1
    for level in range(DEPTH, 0, -1):
        nodes = np.argwhere(pyramid[level] >= (MIXED_FREE if level < DEPTH else FREE))
        children = _child_states(pyramid, first, level, nodes)
        num_nodes += int(np.count_nonzero(children != UNKNOWN))
        bits = TWO_BITS[children] << 2 * np.arange(8)[:, None]
        words.append(bits.sum(axis=0).astype("<u2"))
        keys.append(nodes + (first >> level))
    packed = np.concatenate(words)
    if not len(packed):
        return b"", 0
    return packed[_order(keys, list(range(DEPTH, 0, -1)))].tobytes(), num_nodes


def _pack_odds(pyramid: Pyramid, first: Int) -> tuple[bytes, int]:
    """The nodes of an ``.ot``: four bytes of log-odds and one that says which children there are.

    A node with children has the greatest of their log-odds.
    """
    records, keys = [], []
    has_children = pyramid[DEPTH] >= FREE  # of the level above, index by index
    for level in range(DEPTH, -1, -1):
        states = pyramid[level]
        if level < DEPTH:
            at = [
                (np.arange(n) + (f >> level) >> 1) - (f >> level + 1)
                for n, f in zip(states.shape, first.tolist(), strict=True)
            ]
            has_children = (pyramid[level + 1] >= MIXED_FREE)[np.ix_(*at)]
        nodes = np.argwhere(has_children & (states != UNKNOWN))
        state = states[tuple(nodes.T)]
        record = np.zeros(len(nodes), dtype=[("odds", "<f4"), ("children", "u1")])
        record["odds"] = np.where(state & (OCCUPIED | MIXED), OCCUPIED_ODDS, FREE_ODDS)
        inner = state >= MIXED_FREE
        if inner.any():
            is_there = _child_states(pyramid, first, level, nodes[inner]) != UNKNOWN
            record["children"][inner] = np.packbits(is_there, axis=0, bitorder="little")[0]
        records.append(record)
        keys.append(nodes + (first >> level))
    packed = np.concatenate(records)
    return packed[_order(keys, list(range(DEPTH, -1, -1)))].tobytes(), len(packed)


def _first_key(grid: VoxelGrid) -> Int:
    """The tree's key of the first voxel along each axis."""
    place = np.array(grid.origin) / grid.res
    whole = np.round(place)
    off = np.abs(place - whole).max()
    if off > OFF:
        raise FormatError(
            f"an octree's voxels lie on whole multiples of their edge {grid.res:g} m, and this "
            f"grid's lower corner ({', '.join(f'{c:g}' for c in grid.origin)}) is "
            f"{off * grid.res:.3g} m off: make the grid with align=True (--align)"
        )
    if (np.abs(whole) > CENTER).any() or (np.abs(whole + grid.shape) > CENTER).any():
        raise FormatError(
            f"an octree reaches {CENTER * grid.res:g} m from the origin with voxels of "
            f"{grid.res:g} m, and this grid goes beyond: expected larger voxels or a grid nearer "
            f"to the origin"
        )
    return np.asarray(whole.astype(np.int64) + CENTER)


def _text(res: float) -> str:
    """The edge in six digits, as OctoMap writes it, or in as many as it takes."""
    short = f"{res:g}"
    return short if math.isclose(float(short), res, rel_tol=1e-12) else repr(res)


class _Header(NamedTuple):
    kind: str
    size: int  # number of nodes, as stated
    res: float
    end: int  # where the data begin


def read_octomap(
    source: str | PathLike[str] | bytes,
    *,
    bounds: ArrayLike | None = None,
    max_voxels: int | None = None,
) -> VoxelGrid:
    """Read an octree of class OcTree, ``.bt`` or ``.ot``.

    The grid covers all space that is known, occupied or free; `VoxelGrid.known` says which
    voxels are. Log-odds of 0 and more are occupied.

    Args:
        source: a path, or a file's content.
        bounds: read only this box, (2, 3), lower and upper corner, world frame [m].
        max_voxels: most voxels that the grid may have. If None: 2**31, and no more memory than
            256 MiB and 512 bytes for each byte of the file, with two bytes a voxel and 20 a leaf.

    Raises:
        FormatError: it is no such file, broken, or needs more memory than it may.
    """
    from navbake.formats.kernels.octree import fill_leaves  # numba loads slowly

    data, name = read_bytes(source, begins=MAGIC, expected="an OctoMap file (bt or ot)")
    header = _read_header(data, name)
    place, allowance = JsonPath(name), Allowance(len(data), "max_voxels", max_voxels)
    leaves, notes = _read_leaves(data, header, allowance, place)
    first, shape = _box_leaves(leaves) if bounds is None else _box_keys(bounds, header.res)
    allowance.take_cells(shape, place)
    allowance.take_array(shape, 2, place)
    values, known = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
    fill_leaves(leaves, first, values, known)
    origin = tuple(((first - CENTER) * header.res).tolist())
    unsure = None if known.all() else known
    return VoxelGrid(values=values, origin=origin, res=header.res, known=unsure, notes=notes)


def _read_leaves(
    data: bytes, header: _Header, allowance: Allowance, place: JsonPath
) -> tuple[Int32, list[str]]:
    """The leaves of a tree: first key x, y, z, level, and 1 if occupied, shape (n, 5)."""
    from navbake.formats.kernels.octree import TOO_DEEP, read_leaves  # numba loads slowly

    nodes = np.frombuffer(data, dtype=np.uint8, offset=header.end)
    empty = np.empty((0, 5), np.int32)
    if header.size == 0 and not len(nodes):
        return empty, [f"{place.file} is an empty tree: nothing is known"]
    whole = nodes[: len(nodes) // 5 * 5].reshape(-1, 5)
    odds = np.ascontiguousarray(whole[:, :4]).view("<f4").ravel()  # of an .ot
    # leaves are counted first: the size in the header may be wrong
    has_odds = header.kind == "ot"
    num_leaves, num_bytes, num_nodes = read_leaves(nodes, odds, has_odds, empty)
    if num_leaves < 0:
        what = "a tree deeper than 16" if num_leaves == TOO_DEEP else "an end within the tree"
        raise FormatError(f"expected {header.size} nodes in {place.file}, got {what}")
    if num_bytes != len(nodes):
        got = f"got {len(nodes)}: data run over"
        raise FormatError(f"expected {num_bytes} bytes of nodes in {place.file}, {got}")
    allowance.take_array((num_leaves,), LEAF_BYTES, place)
    leaves = np.empty((num_leaves, 5), np.int32)
    read_leaves(nodes, odds, has_odds, leaves)
    if num_nodes != header.size:
        return leaves, [f"{place.file} has {num_nodes} nodes, and says {header.size}"]
    return leaves, []


def _box_leaves(leaves: Int32) -> Box:
    """The box of all leaves; a single voxel if there are none."""
    if not len(leaves):
        return np.full(3, CENTER), (1, 1, 1)
    low = leaves[:, :3].astype(np.int64)
    first = low.min(axis=0)
    nx, ny, nz = ((low + (1 << leaves[:, 3:4])).max(axis=0) - first).tolist()
    return first, (nx, ny, nz)


def _box_keys(bounds: ArrayLike, res: float) -> Box:
    """The box that a user asked for, (2, 3) [m]; voxels that it reaches into by a hair are out."""
    box = finite_array(bounds, (2, 3))
    if box is None or not (box[0] < box[1]).all():
        raise FormatError(f"expected bounds as (lower, upper) corner [m], got {bounds!r}")
    place = np.clip(box / res + CENTER, -1.0, 2.0 * CENTER + 1.0)  # whole numbers hold no more
    first = np.clip(np.floor(place[0] + OFF), 0, None).astype(np.int64)
    end = np.clip(np.ceil(place[1] - OFF), None, 2 * CENTER).astype(np.int64)
    end = np.where(end == first, first + 1, end)  # a box within a hair of a face
    if (end <= first).any() or (end > 2 * CENTER).any():
        expected = f"bounds within {CENTER * res:g} m of the origin, where the tree reaches"
        raise FormatError(f"expected {expected}, got {box.tolist()}")
    nx, ny, nz = (end - first).tolist()
    return first, (nx, ny, nz)


def _read_header(data: bytes, source: str) -> _Header:
    first = data[:200].partition(b"\n")[0].decode("ascii", errors="replace").strip()
    kind = next((kind for kind, line in FIRST_LINES.items() if first == line), None)
    if kind is None:
        raise FormatError(f"expected an OctoMap file (bt or ot), got {source}")
    lines, end = read_header(data, source)
    fields = {name: " ".join(words) for name, words in lines.items()}
    if fields.get("id") != "OcTree":
        raise FormatError(f"expected a tree of id OcTree in {source}, got {fields.get('id')!r}")
    return _Header(kind, int(_number(fields, "size", source)), _number(fields, "res", source), end)


def _number(fields: dict[str, str], name: str, source: str) -> float:
    try:
        number = float(fields[name])
    except (KeyError, ValueError):
        number = math.nan  # refused below
    if not math.isfinite(number) or number < 0 or (name == "res" and number == 0):
        got = repr(fields.get(name, "none"))
        raise FormatError(f"expected a number > 0 at `{name}` in the header of {source}, got {got}")
    return number
