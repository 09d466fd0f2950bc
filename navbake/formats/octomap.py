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
from navbake.lengths import format_position
from navbake.types import Int
from navbake.voxels.grid import VoxelGrid, to_finite_array

MAGIC = b"# Octomap OcTree"
DEPTH = 16
CENTER_KEY = 2**15  # key of the world's origin
FIRST_LINES = {"bt": "# Octomap OcTree binary file", "ot": "# Octomap OcTree file"}
HEADER_COMMENT = "# (feel free to add / change comments, but leave the first line as it is!)\n#"
LATTICE_TOLERANCE = 1e-3  # by how much a grid may be off the tree's lattice [voxels]
LEAF_BYTES = 20  # of memory for a leaf
# A node of a ColorOcTree's ``.ot``: log-odds, red, green and blue, children (OctoMap 1.9,
# `ColorOcTreeNode::writeData` in ColorOcTree.cpp); its ``.bt`` is that of an OcTree
COLOR_NODE_BYTES = 8
COLOR_BYTES = slice(4, 7)
# OctoMap's clamping thresholds: the log-odds of certainly free or occupied voxels, as bytes
CERTAIN_ODDS = np.array(
    [[math.log(probability / (1 - probability))] for probability in (0.1192, 0.971)], "<f4"
).view(np.uint8)
# states of nodes, as bits: the states of several nodes are joined by bitwise or. A mixed node has
# children of different states; some voxel in it is occupied, or all are free or unknown
UNKNOWN = 1
FREE = 2
OCCUPIED = 4
MIXED_WITHOUT_OCCUPIED = 8
MIXED_WITH_OCCUPIED = 16
# bitwise or of the children's states -> state
NODE_STATES = np.full(32, MIXED_WITHOUT_OCCUPIED, np.uint8)
HAS_OCCUPIED = (np.arange(32) & (OCCUPIED | MIXED_WITH_OCCUPIED)) != 0
NODE_STATES[HAS_OCCUPIED] = MIXED_WITH_OCCUPIED
NODE_STATES[[UNKNOWN, FREE, OCCUPIED]] = [UNKNOWN, FREE, OCCUPIED]
# state of a child -> its bits in the node's entry: two in a ``.bt``, one in an ``.ot``
CHILD_BITS = {"bt": np.full(17, 3, np.int64), "ot": np.ones(17, np.int64)}
CHILD_BITS["bt"][[UNKNOWN, FREE, OCCUPIED]] = [0, 1, 2]
CHILD_BITS["ot"][UNKNOWN] = 0


def encode_octomap(grid: VoxelGrid, kind: str, *, free: bool = False) -> bytes:
    """Encode voxels as an octree; coordinates of corners must be whole multiples of their edge.

    Args:
        grid: the voxels; those with an ID count as occupied.
        kind: ``bt`` or ``ot``.
        free: whether to write voxels that are known to be empty as free. If False, they are
            unknown in the file, as are all voxels that aren't occupied.

    Returns:
        The content of the file.

    Raises:
        FormatError: the kind is unknown, or the voxels are off the tree's lattice or beyond its
            extent.
    """
    if kind not in FIRST_LINES:
        expected = "an octree as bt or ot"
        raise FormatError(f"expected {expected}, got {kind!r}", value=kind, expected=expected)
    first_keys = _find_first_key(grid)
    has_log_odds = kind == "ot"
    bits_per_child = 1 if has_log_odds else 2
    states = np.where(grid.occupied, np.uint8(OCCUPIED), np.uint8(UNKNOWN))
    if free:
        is_known = True if grid.known is None else grid.known
        states[~grid.occupied & is_known] = FREE
    # for all nodes that have an entry in the file: sort key, entry, state
    sort_keys: list[Int] = []
    entries: list[Int] = []
    node_states: list[Int] = []
    num_nodes = 0
    for depth in range(DEPTH, 0, -1):
        level = DEPTH - depth
        level_keys = first_keys >> level
        # children come in pairs along each axis, so the grid is padded to even keys
        padding = [
            (int(key) & 1, (int(key) + num_voxels) & 1)
            for key, num_voxels in zip(level_keys, states.shape, strict=True)
        ]
        child_states = np.pad(states, padding, constant_values=UNKNOWN)
        states = child_states[0::2] | child_states[1::2]
        states = states[:, 0::2] | states[:, 1::2]
        states = NODE_STATES[states[:, :, 0::2] | states[:, :, 1::2]]
        parent_indices = np.argwhere(states >= MIXED_WITHOUT_OCCUPIED)  # of nodes with children
        i, j, k = parent_indices.T
        num_parents_x, num_parents_y, num_parents_z = states.shape
        child_states_in_octets = child_states.reshape(
            num_parents_x, 2, num_parents_y, 2, num_parents_z, 2
        )
        # a child has the number x + 2 y + 4 z
        sibling_states = child_states_in_octets[i, :, j, :, k].swapaxes(1, 3).reshape(-1, 8)
        parent_corners = (parent_indices + (level_keys >> 1)) << (level + 1)
        child_bits = CHILD_BITS[kind][sibling_states] << (np.arange(8) * bits_per_child)
        # the file's order: Morton codes of corners, then parents before children. The lowest 5
        # bits of a sort key are the node's depth.
        parent_keys = _morton_codes(parent_corners) << 5
        sort_keys.append(parent_keys | (depth - 1))
        entries.append(child_bits.sum(axis=1))
        node_states.append(states[i, j, k].astype(np.int64))
        num_nodes += int(np.count_nonzero(sibling_states != UNKNOWN))
        if depth == 1:
            num_nodes += len(parent_indices)  # the root
        if has_log_odds:  # leaves have entries as well, of no children
            node_index, child_index = np.nonzero(
                (sibling_states != UNKNOWN) & (sibling_states < MIXED_WITHOUT_OCCUPIED)
            )
            # a child's number is three bits of the Morton code of its corner
            child_bits_of_key = child_index << (3 * level + 5)
            leaf_keys = parent_keys[node_index] | child_bits_of_key | depth
            sort_keys.append(leaf_keys)
            entries.append(np.zeros_like(leaf_keys))
            node_states.append(sibling_states[node_index, child_index].astype(np.int64))
    sort_indices = np.argsort(np.concatenate(sort_keys))
    nodes = np.concatenate(entries)[sort_indices].astype("<u2")
    if has_log_odds:  # a node has the greatest log-odds of its children
        sorted_states = np.concatenate(node_states)[sort_indices]
        is_occupied = (sorted_states & (OCCUPIED | MIXED_WITH_OCCUPIED)) != 0
        log_odds = CERTAIN_ODDS[is_occupied.astype(np.int64)]
        nodes = np.append(log_odds, nodes[:, None].astype(np.uint8), axis=1)
    res_text = f"{grid.res:g}"  # six digits, as OctoMap writes it, if they are exact
    if not math.isclose(float(res_text), grid.res, rel_tol=1e-12):
        res_text = repr(grid.res)
    header = (
        f"{FIRST_LINES[kind]}\n{HEADER_COMMENT}\n"
        f"id OcTree\nsize {num_nodes}\nres {res_text}\ndata\n"
    )
    return header.encode() + nodes.tobytes()


def _morton_codes(coordinates: Int) -> Int:
    """Interleave the bits of x, y and z: those of x are the lowest of each three.

    Args:
        coordinates: x, y, z, each below 2**16, shape (n, 3).

    Returns:
        The codes, shape (n,).
    """
    codes = coordinates.copy()
    masks = (0xFF0000FF, 0xF00F00F00F, 0xC30C30C30C3, 0x249249249249)
    for shift, mask in zip((16, 8, 4, 2), masks, strict=True):
        codes = (codes | codes << shift) & mask
    morton_codes: Int = codes[:, 0] | codes[:, 1] << 1 | codes[:, 2] << 2
    return morton_codes


def _find_first_key(grid: VoxelGrid) -> Int:
    """Return the keys of the grid's first voxel along each axis, shape (3,)."""
    corner_in_voxels = np.array(grid.origin) / grid.res
    nearest_corner = np.round(corner_in_voxels)
    max_misalignment = np.abs(corner_in_voxels - nearest_corner).max()
    if max_misalignment > LATTICE_TOLERANCE:
        raise FormatError(
            f"an octree's voxels lie on whole multiples of their edge {grid.res:g} m, and this "
            f"grid's lower corner ({format_position(grid.origin)}) is "
            f"{max_misalignment * grid.res:.3g} m off: make the grid with align=True (--align)"
        )
    if np.abs([nearest_corner, nearest_corner + grid.shape]).max() > CENTER_KEY:
        max_extent = CENTER_KEY * grid.res
        raise FormatError(
            f"an octree reaches {max_extent:g} m from the origin with voxels of {grid.res:g}"
            " m, and this grid goes beyond: expected larger voxels or a grid nearer to the origin"
        )
    return np.asarray(nearest_corner.astype(np.int64) + CENTER_KEY)


def read_octomap(
    source: str | PathLike[str] | bytes,
    *,
    bounds: ArrayLike | None = None,
    max_voxels: int | None = None,
) -> VoxelGrid:
    """Read an octree of class OcTree or ColorOcTree, ``.bt`` or ``.ot``.

    Log-odds of 0 and more are occupied. Colours are left out.

    Args:
        source: a path, or the file's content.
        bounds: lower and upper corner of the box to read, shape (2, 3), world frame [m]; None for
            all known space, occupied or free.
        max_voxels: the largest number of voxels; None for 2**31, as far as memory allows, see
            `navbake.load_voxels`.

    Returns:
        The voxels; `VoxelGrid.known` marks those that the tree knows.

    Raises:
        FormatError: the file is no octree, is broken, or needs too much memory.
    """
    from navbake.compiled import ensure_compiled  # numba loads slowly
    from navbake.formats.octree_kernels import TOO_DEEP, fill_leaves, read_leaves  # as above

    ensure_compiled("formats.octree_kernels.")
    data, name = read_bytes(source, beginnings=MAGIC, expected="an OctoMap file (bt or ot)")
    kind, num_stated_nodes, res, data_offset, has_colors = _read_header(data, name)
    place = JsonPath(name)
    allowance = Allowance(len(data), "max_voxels", max_voxels)
    nodes = np.frombuffer(data, dtype=np.uint8, offset=data_offset)
    if has_colors and kind == "ot":
        num_whole_records = len(nodes) // COLOR_NODE_BYTES
        records = nodes[: num_whole_records * COLOR_NODE_BYTES].reshape(-1, COLOR_NODE_BYTES)
        last_bytes = nodes[num_whole_records * COLOR_NODE_BYTES :]
        nodes = np.append(np.delete(records, COLOR_BYTES, axis=1).ravel(), last_bytes)
    notes = list[str]()
    leaves = np.empty((0, 5), np.int32)
    if num_stated_nodes == 0 and not len(nodes):
        notes.append(f"{name} is an empty tree: nothing is known")
    else:
        entries = nodes[: len(nodes) // 5 * 5].reshape(-1, 5)
        log_odds = np.ascontiguousarray(entries[:, :4]).view("<f4").ravel()  # of an .ot
        # leaves are counted first: the size in the header may be wrong
        num_leaves, num_bytes, num_nodes = read_leaves(nodes, log_odds, kind == "ot", leaves)
        if num_leaves < 0:
            actual_text = (
                "a tree deeper than 16" if num_leaves == TOO_DEEP else "an end within the tree"
            )
            raise FormatError(
                f"expected {num_stated_nodes} nodes in {name}, got {actual_text}", path=name
            )
        if num_bytes != len(nodes):
            actual_text = f"{len(nodes)}: data run over"
            message = f"expected {num_bytes} bytes of nodes in {name}, got {actual_text}"
            raise FormatError(message, path=name)
        allowance.take_array((num_leaves,), LEAF_BYTES, place)
        leaves = np.empty((num_leaves, 5), np.int32)
        read_leaves(nodes, log_odds, kind == "ot", leaves)
        if num_nodes != num_stated_nodes:
            notes.append(f"{name} has {num_nodes} nodes, and says {num_stated_nodes}")
    if bounds is not None:
        first_keys, shape = _find_box_keys(bounds, res)
    elif len(leaves):
        lowest_keys = leaves[:, :3].astype(np.int64)
        first_keys = lowest_keys.min(axis=0)
        leaf_edges = 1 << leaves[:, 3:4]  # [voxels]
        end_keys = (lowest_keys + leaf_edges).max(axis=0)
        shape = tuple((end_keys - first_keys).tolist())
    else:
        first_keys = np.full(3, CENTER_KEY)
        shape = (1, 1, 1)
    allowance.take_cells(shape, place)
    allowance.take_array(shape, 2, place)
    values = np.zeros(shape, dtype=np.bool_)
    is_known = np.zeros(shape, dtype=np.bool_)
    fill_leaves(leaves, first_keys, values, is_known)
    origin = tuple(((first_keys - CENTER_KEY) * res).tolist())
    return VoxelGrid(
        values=values,
        origin=origin,
        res=res,
        known=None if is_known.all() else is_known,
        notes=notes,
    )


def _find_box_keys(bounds: ArrayLike, res: float) -> tuple[Int, tuple[int, ...]]:
    """Return the first keys and the counts of the voxels that overlap a box, along each axis.

    Voxels that the box only touches don't count.
    """
    box = to_finite_array(bounds, (2, 3))
    if box is None or not (box[0] < box[1]).all():
        expected = "bounds as (lower, upper) corner [m]"
        raise FormatError(
            f"expected {expected}, got {bounds!r}", key="bounds", value=bounds, expected=expected
        )
    box_keys = np.clip(box / res + CENTER_KEY, -1.0, 2.0 * CENTER_KEY + 1.0)  # to fit integers
    first_keys = np.clip(np.floor(box_keys[0] + LATTICE_TOLERANCE), 0, None).astype(np.int64)
    stop_keys = np.clip(np.ceil(box_keys[1] - LATTICE_TOLERANCE), None, 2 * CENTER_KEY).astype(
        np.int64
    )
    stop_keys = np.where(
        stop_keys == first_keys, first_keys + 1, stop_keys
    )  # a box within the tolerance of a face
    if (stop_keys <= first_keys).any() or (stop_keys > 2 * CENTER_KEY).any():
        expected = f"bounds within {CENTER_KEY * res:g} m of the origin, where the tree reaches"
        raise FormatError(
            f"expected {expected}, got {box.tolist()}",
            key="bounds",
            value=bounds,
            expected=expected,
        )
    return first_keys, tuple((stop_keys - first_keys).tolist())


def _read_header(data: bytes, source: str) -> tuple[str, int, float, int, bool]:
    """Return a file's kind, number of nodes, edge of voxels [m], offset of data, and colours.

    The last value is whether the tree is a ColorOcTree.
    """
    first_line = data[:200].partition(b"\n")[0].decode("ascii", errors="replace").strip()
    kind = next((kind for kind, line in FIRST_LINES.items() if first_line == line), None)
    if kind is None:
        expected = "an OctoMap file (bt or ot)"
        raise FormatError(f"expected {expected}, got {source}", path=source, expected=expected)
    number_types_of_lines = {"size": (1, float), "res": (1, float)}
    lines, numbers, data_offset = read_header(data, source, number_types_of_lines)
    num_nodes = numbers[0][0]
    res = numbers[1][0]
    if lines.get("id") not in (["OcTree"], ["ColorOcTree"]):
        actual_text = " ".join(lines.get("id", ["none"]))
        raise FormatError(
            f"expected a tree of id OcTree or ColorOcTree in {source}, got {actual_text!r}",
            path=source,
            key="id",
            value=actual_text,
        )
    if num_nodes < 0 or not res > 0:
        place_text = f"`size` and `res` in the header of {source}"
        message = f"expected numbers > 0 as {place_text}, got {num_nodes:g} and {res:g}"
        raise FormatError(message, path=source, expected="numbers > 0")
    return kind, int(num_nodes), res, data_offset, lines["id"] == ["ColorOcTree"]
