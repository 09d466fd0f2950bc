"""What broken, huge and endless files may cost: memory by the size of the file, and no more."""

import io
import os
import struct
import zipfile
import zlib

import numpy as np
import pytest

import navbake
from navbake.errors import FormatError, NavbakeError
from navbake.formats import allowance
from navbake.formats.allowance import BASE_MEMORY, MAX_VOXELS, MEMORY_PER_FILE_BYTE
from navbake.formats.npz import encode_npz, read_grid_npz, read_npy, read_npz
from navbake.formats.octomap import encode_octomap, read_octomap
from navbake.formats.procthor import read_procthor
from navbake.formats.source import open_image
from navbake.formats.voxels import read_binvox, read_voxels
from navbake.voxels.grid import VoxelGrid

ENDLESS = "/dev/zero"
needs_devices = pytest.mark.skipif(not os.path.exists(ENDLESS), reason="no endless device here")


def voxels(shape=(5, 6, 7)):
    values = np.random.default_rng(0).random(shape) < 0.4
    return VoxelGrid(values=values, origin=(0.0, 0.0, 0.0), res=0.5)


def tree_with_one_leaf(level):
    """A .bt whose only leaf has edges of 2**level voxels."""
    nodes = [0b11] * (15 - level) + [0b10]  # child 0 of each is inner, that of the last occupied
    header = f"# Octomap OcTree binary file\nid OcTree\nsize {len(nodes) + 1}\nres 0.1\ndata\n"
    return header.encode() + b"".join(node.to_bytes(2, "little") for node in nodes)


# ---------------------------------------------------------------- octrees


def test_a_leaf_of_an_octree_is_as_large_as_it_says():
    grid = read_octomap(tree_with_one_leaf(3))
    assert grid.shape == (8, 8, 8) and grid.values.all() and not grid.notes


def test_few_bytes_of_an_octree_do_not_fill_gigabytes():
    with pytest.raises(FormatError, match=r"more memory than a file of \d+ bytes may fill .*max_v"):
        read_octomap(tree_with_one_leaf(10))  # 1024 voxels each way, 2 bytes each
    with pytest.raises(FormatError, match=r"too many voxels \(2048 × 2048 × 2048"):
        read_octomap(tree_with_one_leaf(11))
    part = read_octomap(
        tree_with_one_leaf(11), bounds=((-3277, -3277, -3277), (-3276, -3276, -3276))
    )
    assert part.values.any()


def test_no_flipped_bit_of_an_octree_takes_more_than_the_rule_says(monkeypatch):
    monkeypatch.setattr(allowance, "BASE_MEMORY", 100_000)
    grid = voxels()
    outcomes = set()
    for kind in ("bt", "ot"):
        data = encode_octomap(grid, kind)
        limit = 100_000 + MEMORY_PER_FILE_BYTE * len(data)
        for at in range(data.index(b"data\n") + 5, len(data)):
            for bit in range(8):
                changed = bytearray(data)
                changed[at] ^= 1 << bit
                try:
                    found = read_octomap(bytes(changed))
                except FormatError as error:
                    outcomes.add("memory" if "more memory than" in str(error) else "broken")
                else:
                    outcomes.add("read")
                    assert 2 * found.values.size <= limit
    assert outcomes == {"memory", "broken", "read"}


def test_max_voxels_lifts_the_rule(monkeypatch):
    monkeypatch.setattr(allowance, "BASE_MEMORY", 1000)
    data = tree_with_one_leaf(5)
    with pytest.raises(FormatError, match="max_voxels"):
        read_octomap(data)
    assert read_octomap(data, max_voxels=32**3).values.all()
    with pytest.raises(FormatError, match="32 × 32 × 32, expected 32,767 at most"):
        read_octomap(data, max_voxels=32**3 - 1)
    for wrong in (0, -1, 1.5, "9"):
        with pytest.raises(FormatError, match="max_voxels to be a whole number >= 1"):
            read_octomap(data, max_voxels=wrong)


# ---------------------------------------------------------------- .npz and binvox


def bomb(tmp_path, num_bytes):
    """A small archive that unpacks to an array of so many zeros."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "|u1", "fortran_order": False, "shape": (num_bytes // 1024, 32, 32)}
    )
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in (("origin.npy", np.zeros(3)), ("res.npy", np.float64(1))):
            with archive.open(name, "w") as file:
                np.lib.format.write_array(file, np.asarray(array))
        with archive.open("values.npy", "w") as file:
            file.write(header.getvalue())
            for _ in range(num_bytes >> 20):
                file.write(bytes(1 << 20))
    return path


def test_a_small_archive_does_not_unpack_to_gigabytes(tmp_path, monkeypatch):
    monkeypatch.setattr(allowance, "BASE_MEMORY", 4 << 20)
    path = bomb(tmp_path, 16 << 20)
    assert 100 * path.stat().st_size < 16 << 20
    with pytest.raises(FormatError, match="more memory than a file of"):
        read_voxels(path)
    assert read_voxels(path, max_voxels=1 << 30).values.nbytes == 16 << 20


def test_what_an_archive_only_claims_is_not_reserved(tmp_path):
    members = {}
    with zipfile.ZipFile(io.BytesIO(encode_npz(voxels()))) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for claim in (b"(50, 60, 7)", b"(500, 60, 70)", b"(-5, -6, 7)"):
        values = members["values.npy"].replace(b"(5, 6, 7)", claim, 1)
        with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
            for name, content in (members | {"values.npy": values}).items():
                archive.writestr(name, content)
        with pytest.raises(FormatError, match=r"`values\.npy` does not hold|can't be read"):
            read_npz(tmp_path / "a.npz")


def test_what_a_binvox_header_only_claims_is_not_reserved(monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("reserved")

    monkeypatch.setattr(np, "zeros", refuse)
    with pytest.raises(FormatError, match="got 255 voxels: too few"):
        read_binvox(b"#binvox 1\ndim 1000 1000 1000\ndata\n\x01\xff")


def test_the_rule_is_the_same_on_every_system(monkeypatch):
    # where the system does not say how much memory is free, the rule of the file still holds
    monkeypatch.setattr("navbake.voxels.grid.measure_free_memory", lambda: 2**62)
    with pytest.raises(FormatError, match="more memory than a file of"):
        read_octomap(tree_with_one_leaf(10))
    assert BASE_MEMORY == 256 << 20 and MAX_VOXELS == 2**31


# ---------------------------------------------------------------- endless and over-large files


@needs_devices
@pytest.mark.parametrize("suffix", [".binvox", ".bt", ".ot", ".npz"])
def test_an_endless_file_is_not_read_on(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.symlink_to(ENDLESS)
    with pytest.raises(FormatError, match=f"expected .*, got .*a{suffix}"):
        read_voxels(path)


@needs_devices
def test_other_endless_files(tmp_path):
    with pytest.raises(FormatError, match="expected a NavGrid JSON object"):
        navbake.load(ENDLESS)


def sparse(path, size, begin=b"#binvox 1\n"):
    """A file that says it has so many bytes, and takes no room."""
    with open(path, "wb") as file:
        file.write(begin)
        file.truncate(size)
    return path


@pytest.mark.parametrize(
    ("name", "begin", "size", "read"),
    [
        ("a.json", b"{", 4 << 30, navbake.load),
        ("a.npz", b"PK", 4 << 30, read_grid_npz),
        ("a.binvox", b"#binvox 1\n", 4 << 30, read_voxels),
        ("a.bt", b"# Octomap OcTree binary file\n", 4 << 30, read_voxels),
        ("a.npz", b"PK", 4 << 30, read_voxels),
        ("a.png", b"\x89PNG", 4 << 30, read_procthor),
        ("a.npy", b"\x93NUMPY", 4 << 30, read_npy),
    ],
)
def test_files_that_are_too_large_are_refused_unread(tmp_path, name, begin, size, read):
    path = sparse(tmp_path / name, size + 1, begin)
    most = f"{size >> 20} MiB" if size >> 20 else f"{size:,} bytes"
    with pytest.raises(NavbakeError, match=f"more than {most} of data in .*{path.name}"):
        read(path)


def image_bomb(edge):
    """A PNG of so many pixels each way, all of one grey."""
    rows = zlib.compress(bytes(edge * (edge + 1)), 9)
    chunks = (b"IHDR", struct.pack(">2I5B", edge, edge, 8, 0, 0, 0, 0)), (b"IDAT", rows)
    packed = (struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c))
              for k, c in (*chunks, (b"IEND", b"")))  # fmt: skip
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


def test_a_small_image_does_not_unpack_to_gigabytes(monkeypatch):
    monkeypatch.setattr(allowance, "BASE_MEMORY", 6_000_000)
    assert open_image(image_bomb(1000)).size == (1000, 1000)
    with pytest.raises(FormatError, match=r"more memory than a file of .* bytes may fill"):
        open_image(image_bomb(1500))
    monkeypatch.setattr(allowance, "MAX_PIXELS", 90_000)
    with pytest.raises(FormatError, match="too many pixels"):
        open_image(image_bomb(301))


def test_the_text_of_an_archive_is_limited(tmp_path, monkeypatch):
    monkeypatch.setattr(allowance, "BASE_MEMORY", 1 << 20)
    monkeypatch.setattr(allowance, "MEMORY_PER_FILE_BYTE", 1)
    for text, culprit in (
        (b"{" + b" " * (2 << 20), "more text than a file of .* bytes may unpack to"),
        (b"{" + b" " * 10, "broken JSON"),
    ):
        file = io.BytesIO()
        np.savez_compressed(file, grid=np.frombuffer(text, dtype=np.uint8))
        with pytest.raises(FormatError, match=culprit):
            read_grid_npz(file.getvalue())


def test_single_arrays_are_not_reserved_before_they_are_there(tmp_path):
    np.save(tmp_path / "a.npy", np.ones((3, 4), dtype=bool))
    data = (tmp_path / "a.npy").read_bytes()
    assert read_npy(data).shape == (3, 4)
    for claim in (b"(9999999999, 4)", b"(-1, 4)", b"(3, 4, 1000)"):
        with pytest.raises(FormatError, match="can't be read"):
            read_npy(data.replace(b"(3, 4)", claim))
