"""OctoMap trees: voxels as octrees, ``.bt`` (occupied, free, unknown) and ``.ot`` (log-odds).

A tree has depth 16; a voxel's key is ``floor(coordinate / res) + 32768`` along each axis. So the
corners of voxels are multiples of `res`, at most 32768 of them from the world's origin.
Children that are equal are pruned. Files are the same, byte for byte, as OctoMap's own.

They are built bottom up: a pyramid holds the state of each node over the grid, level by level, 0
the voxels, 16 the root. Then a walk from the root, depth first, writes the nodes.

Source: OctoMap 1.9 (`AbstractOcTree.cpp`, `OccupancyOcTreeBase.hxx`, `OcTreeBaseImpl.hxx`): the
header's lines, the order of the nodes, pruning, and the log-odds of what is certain.
"""

import math
from os import PathLike
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import FormatError
from navbake.formats.allowance import Allowance, JsonPath
from navbake.formats.binvox import read_header
from navbake.formats.source import read_bytes
from navbake.types import Int, Int32
from navbake.voxels.grid import VoxelGrid
from navbake.voxels.placement import finite_array

MAGIC = b"# Octomap OcTree"
CENTER = 2**15  # key of the world's origin
FIRST_LINES = {"bt": "# Octomap OcTree binary file", "ot": "# Octomap OcTree file"}
COMMENT = "# (feel free to add / change comments, but leave the first line as it is!)\n#"
OFF = 1e-3  # of a voxel: what a grid may lie off the tree's lattice
LEAF_BYTES = 20  # of a leaf in memory
# OctoMap's clamping thresholds: the log-odds of what is certainly free or occupied
ODDS = np.array([[math.log(p / (1 - p))] for p in (0.1192, 0.971)], "<f4").view(np.uint8)

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
    from navbake.formats.kernels import octree  # numba loads slowly

    if kind not in FIRST_LINES:
        raise FormatError(f"expected an octree as bt or ot, got {kind!r}")
    first = _first_key(grid)
    states = np.where(grid.occupied, np.uint8(octree.IS_OCCUPIED), np.uint8(octree.IS_UNKNOWN))
    if free:
        known = True if grid.known is None else grid.known
        states[~grid.occupied & known] = octree.IS_FREE
    # by the bitwise or of eight children, what a node is: as they are, or mixed
    kinds = np.full(32, octree.MIXED_FREE, np.uint8)
    kinds[[n for n in range(32) if n & (octree.IS_OCCUPIED | octree.MIXED)]] = octree.MIXED
    for alike in (octree.IS_UNKNOWN, octree.IS_FREE, octree.IS_OCCUPIED):
        kinds[alike] = alike
    pyramid = [states]
    for level in range(octree.DEPTH):
        begin = (first >> level).tolist()
        even = [(k & 1, k + n & 1) for k, n in zip(begin, states.shape, strict=True)]
        states = np.pad(states, even, constant_values=octree.IS_UNKNOWN)
        states = states[0::2] | states[1::2]
        states = states[:, 0::2] | states[:, 1::2]
        states = kinds[states[:, :, 0::2] | states[:, :, 1::2]]
        pyramid.append(states)
    nodes, num_nodes = np.empty(0, np.uint8), 0
    if states[0, 0, 0] != octree.IS_UNKNOWN:
        num_inner = sum(int(np.count_nonzero(own >= octree.MIXED_FREE)) for own in pyramid)
        odds = ODDS if kind == "ot" else ODDS[:0]
        nodes = np.empty(5 * (1 + 8 * num_inner) if len(odds) else 2 * num_inner, np.uint8)
        num_bytes, num_nodes = octree.pack_nodes(
            np.concatenate([own.ravel() for own in pyramid]),
            np.array([own.shape for own in pyramid]),
            np.array([first >> level for level in range(len(pyramid))]),
            odds,
            nodes,
        )
        nodes = nodes[:num_bytes]
    short = f"{grid.res:g}"  # six digits, as OctoMap writes it, or as many as it takes
    res = short if math.isclose(float(short), grid.res, rel_tol=1e-12) else repr(grid.res)
    header = f"{FIRST_LINES[kind]}\n{COMMENT}\nid OcTree\nsize {num_nodes}\nres {res}\ndata\n"
    return header.encode() + nodes.tobytes()


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
    if bounds is not None:
        first, shape = _box_keys(bounds, header.res)
    elif len(leaves):
        low = leaves[:, :3].astype(np.int64)
        first = low.min(axis=0)
        nx, ny, nz = ((low + (1 << leaves[:, 3:4])).max(axis=0) - first).tolist()
        shape = nx, ny, nz
    else:
        first, shape = np.full(3, CENTER), (1, 1, 1)
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
    is_odd = num_nodes != header.size
    return leaves, [f"{place.file} has {num_nodes} nodes, and says {header.size}"] * is_odd


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
    numbers = []
    for name in ("size", "res"):
        try:
            number = float(fields[name])
        except (KeyError, ValueError):
            number = math.nan  # refused below
        if not math.isfinite(number) or number < 0 or (name == "res" and number == 0):
            got = repr(fields.get(name, "none"))
            where = f"at `{name}` in the header of {source}"
            raise FormatError(f"expected a number > 0 {where}, got {got}")
        numbers.append(number)
    return _Header(kind, int(numbers[0]), numbers[1], end)
