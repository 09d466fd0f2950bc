"""OctoMap trees: voxels as octrees, ``.bt`` (occupied, free, unknown) and ``.ot`` (log-odds).

A tree has depth 16; a voxel's key is ``floor(coordinate / res) + 32768`` along each axis. So the
corners of voxels are multiples of `res`, at most 32768 of them from the world's origin.
Equal children are pruned. Files equal OctoMap's own byte for byte.

Trees are built bottom up: each node's state follows from its eight children's, level by level.
Files are depth first: in the order of the corners' Morton codes, parents before children.

Source: OctoMap 1.9 (`AbstractOcTree.cpp`, `OccupancyOcTreeBase.hxx`, `OcTreeBaseImpl.hxx`): the
header's lines, the order of the nodes, pruning, and the log-odds of certain voxels.
"""

import math
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import FormatError
from navbake.formats.allowance import Allowance, JsonPath
from navbake.formats.source import read_bytes, read_header
from navbake.types import Int
from navbake.voxels.grid import VoxelGrid, finite_array

MAGIC = b"# Octomap OcTree"
# key of the world's origin
DEPTH = 16
CENTER = 2**15
FIRST_LINES = {"bt": "# Octomap OcTree binary file", "ot": "# Octomap OcTree file"}
COMMENT = "# (feel free to add / change comments, but leave the first line as it is!)\n#"
OFF = 1e-3  # of a voxel: tolerance from the tree's lattice
LEAF_BYTES = 20  # of a leaf in memory
# OctoMap's clamping thresholds: the log-odds of certainly free or occupied voxels
ODDS = np.array([[math.log(p / (1 - p))] for p in (0.1192, 0.971)], "<f4").view(np.uint8)
# states of nodes as bits, joined by bitwise or. MIXED nodes have children that differ, MIXED_FREE
# ones no occupied child
UNKNOWN = 1
FREE = 2
OCCUPIED = 4
MIXED_FREE = 8
MIXED = 16
STATES = np.full(32, MIXED_FREE, np.uint8)  # of a node, by the bitwise or of its children's
STATES[[n for n in range(32) if n & (OCCUPIED | MIXED)]] = MIXED
STATES[[UNKNOWN, FREE, OCCUPIED]] = UNKNOWN, FREE, OCCUPIED
# of a child in its parent's entry, by state: two bits in a ``.bt``, one in an ``.ot``
ENTRIES = {"bt": np.full(17, 3, np.int64), "ot": np.ones(17, np.int64)}
ENTRIES["bt"][[UNKNOWN, FREE, OCCUPIED]] = 0, 1, 2
ENTRIES["ot"][UNKNOWN] = 0


def encode_octomap(grid: VoxelGrid, kind: str, *, free: bool = False) -> bytes:
    """Encode a grid on whole multiples of its edge as an octree, ``bt`` or ``ot``.

    IDs count as occupied. `free` writes known voxels that are not occupied as free, not as unknown.
    Raises a FormatError for a grid off the tree's lattice, or beyond it.
    """
    if kind not in FIRST_LINES:
        raise FormatError(f"expected an octree as bt or ot, got {kind!r}")
    first = _first_key(grid)
    has_odds = kind == "ot"
    states = np.where(grid.occupied, np.uint8(OCCUPIED), np.uint8(UNKNOWN))
    if free:
        known = True if grid.known is None else grid.known
        states[~grid.occupied & known] = FREE
    found: list[tuple[Int, Int, Int]] = []  # of nodes that have an entry: order, entry, state
    num_nodes = 0
    for depth in range(DEPTH, 0, -1):
        begin = first >> (DEPTH - depth)
        level = DEPTH - depth
        even = [(k & 1, k + n & 1) for k, n in zip(begin.tolist(), states.shape, strict=True)]
        below = np.pad(states, even, constant_values=UNKNOWN)
        states = below[0::2] | below[1::2]
        states = states[:, 0::2] | states[:, 1::2]
        states = STATES[states[:, :, 0::2] | states[:, :, 1::2]]
        place = np.argwhere(states >= MIXED_FREE)
        row, col, up = place.T
        blocks = below.reshape([n for half in states.shape for n in (half, 2)])
        # number x + 2 y + 4 z
        children = blocks[row, :, col, :, up].swapaxes(1, 3).reshape(-1, 8)
        corners = (place + (begin >> 1)) << (level + 1)
        bits = ENTRIES[kind][children] << (np.arange(8) * (1 if has_odds else 2))
        order = _morton_codes(corners) << 5
        found.append((order | depth - 1, bits.sum(axis=1), states[row, col, up].astype(np.int64)))
        num_nodes += int(np.count_nonzero(children != UNKNOWN)) + (depth == 1 and len(place))
        if has_odds:
            node, child = np.nonzero((children != UNKNOWN) & (children < MIXED_FREE))
            leaf = order[node] | (child << 3 * level + 5) | depth
            own = children[node, child].astype(np.int64)
            found.append((leaf, np.zeros_like(leaf), own))
    order, bits, own = (np.concatenate(each) for each in zip(*found, strict=True))
    ranks = np.argsort(order)
    nodes = bits[ranks].astype("<u2")
    if has_odds:  # a node has the greatest log-odds of its children
        odds = ODDS[((own[ranks] & (OCCUPIED | MIXED)) != 0).astype(np.int64)]
        nodes = np.append(odds, nodes[:, None].astype(np.uint8), axis=1)
    short = f"{grid.res:g}"  # six digits, as OctoMap writes it, if they are exact
    res = short if math.isclose(float(short), grid.res, rel_tol=1e-12) else repr(grid.res)
    header = f"{FIRST_LINES[kind]}\n{COMMENT}\nid OcTree\nsize {num_nodes}\nres {res}\ndata\n"
    return header.encode() + nodes.tobytes()


def _morton_codes(places: Int) -> Int:
    """Interleaved bits of x, y, z below 2**16, x the lowest, shape (n,)."""
    codes = places.copy()
    masks = (0xFF0000FF, 0xF00F00F00F, 0xC30C30C30C3, 0x249249249249)
    for shift, mask in zip((16, 8, 4, 2), masks, strict=True):
        codes = (codes | codes << shift) & mask
    spread: Int = codes[:, 0] | codes[:, 1] << 1 | codes[:, 2] << 2
    return spread


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
    if np.abs([whole, whole + grid.shape]).max() > CENTER:
        raise FormatError(
            f"an octree reaches {CENTER * grid.res:g} m from the origin with voxels of {grid.res:g}"
            " m, and this grid goes beyond: expected larger voxels or a grid nearer to the origin"
        )
    return np.asarray(whole.astype(np.int64) + CENTER)


def read_octomap(
    source: str | PathLike[str] | bytes,
    *,
    bounds: ArrayLike | None = None,
    max_voxels: int | None = None,
) -> VoxelGrid:
    """Read an octree of class OcTree, ``.bt`` or ``.ot``; see `navbake.load_voxels`.

    The grid covers all known space, occupied or free, or the box `bounds`, (2, 3), lower and upper
    corner, world frame [m]; `VoxelGrid.known` marks known voxels. Log-odds of 0 and more are
    occupied. Raises a FormatError for a file that is no octree, broken, or needs too much memory.
    """
    from navbake.compiled import ensure_compiled  # numba loads slowly
    from navbake.formats.octree_kernels import TOO_DEEP, fill_leaves, read_leaves  # as above

    ensure_compiled("formats.octree_kernels.")
    data, name = read_bytes(source, begins=MAGIC, expected="an OctoMap file (bt or ot)")
    kind, size, res, end = _read_header(data, name)
    place = JsonPath(name)
    allowance = Allowance(len(data), "max_voxels", max_voxels)
    nodes = np.frombuffer(data, dtype=np.uint8, offset=end)
    notes = list[str]()
    leaves = np.empty((0, 5), np.int32)
    if size == 0 and not len(nodes):
        notes.append(f"{name} is an empty tree: nothing is known")
    else:
        whole = nodes[: len(nodes) // 5 * 5].reshape(-1, 5)
        odds = np.ascontiguousarray(whole[:, :4]).view("<f4").ravel()  # of an .ot
        # leaves are counted first: the size in the header may be wrong
        num_leaves, num_bytes, num_nodes = read_leaves(nodes, odds, kind == "ot", leaves)
        if num_leaves < 0:
            what = "a tree deeper than 16" if num_leaves == TOO_DEEP else "an end within the tree"
            raise FormatError(f"expected {size} nodes in {name}, got {what}")
        if num_bytes != len(nodes):
            got = f"got {len(nodes)}: data run over"
            raise FormatError(f"expected {num_bytes} bytes of nodes in {name}, {got}")
        allowance.take_array((num_leaves,), LEAF_BYTES, place)
        leaves = np.empty((num_leaves, 5), np.int32)
        read_leaves(nodes, odds, kind == "ot", leaves)
        notes += [f"{name} has {num_nodes} nodes, and says {size}"] * (num_nodes != size)
    if bounds is not None:
        first, shape = _box_keys(bounds, res)
    elif len(leaves):
        low = leaves[:, :3].astype(np.int64)
        first = low.min(axis=0)
        shape = tuple(((low + (1 << leaves[:, 3:4])).max(axis=0) - first).tolist())
    else:
        first = np.full(3, CENTER)
        shape = (1, 1, 1)
    allowance.take_cells(shape, place)
    allowance.take_array(shape, 2, place)
    values = np.zeros(shape, dtype=np.bool_)
    known = np.zeros(shape, dtype=np.bool_)
    fill_leaves(leaves, first, values, known)
    origin = tuple(((first - CENTER) * res).tolist())
    unsure = None if known.all() else known
    return VoxelGrid(values=values, origin=origin, res=res, known=unsure, notes=notes)


def _box_keys(bounds: ArrayLike, res: float) -> tuple[Int, tuple[int, ...]]:
    """First keys and counts of the voxels in a box, (2, 3) [m], without those it only touches."""
    box = finite_array(bounds, (2, 3))
    if box is None or not (box[0] < box[1]).all():
        raise FormatError(f"expected bounds as (lower, upper) corner [m], got {bounds!r}")
    place = np.clip(box / res + CENTER, -1.0, 2.0 * CENTER + 1.0)  # to fit integers
    first = np.clip(np.floor(place[0] + OFF), 0, None).astype(np.int64)
    end = np.clip(np.ceil(place[1] - OFF), None, 2 * CENTER).astype(np.int64)
    end = np.where(end == first, first + 1, end)  # a box within a hair of a face
    if (end <= first).any() or (end > 2 * CENTER).any():
        expected = f"bounds within {CENTER * res:g} m of the origin, where the tree reaches"
        raise FormatError(f"expected {expected}, got {box.tolist()}")
    return first, tuple((end - first).tolist())


def _read_header(data: bytes, source: str) -> tuple[str, int, float, int]:
    """The kind, the stated number of nodes and edge, and the offset of the data."""
    first = data[:200].partition(b"\n")[0].decode("ascii", errors="replace").strip()
    kind = next((kind for kind, line in FIRST_LINES.items() if first == line), None)
    if kind is None:
        raise FormatError(f"expected an OctoMap file (bt or ot), got {source}")
    lines, ((size,), (res,)), end = read_header(
        data, source, {"size": (1, float), "res": (1, float)}
    )
    if lines.get("id") != ["OcTree"]:
        got = " ".join(lines.get("id", ["none"]))
        raise FormatError(f"expected a tree of id OcTree in {source}, got {got!r}")
    if size < 0 or not res > 0:
        where = f"`size` and `res` in the header of {source}"
        raise FormatError(f"expected numbers > 0 as {where}, got {size:g} and {res:g}")
    return kind, int(size), res, end
