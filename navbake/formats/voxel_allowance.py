"""How much a voxel file may fill: memory by the size of the file, on every system alike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from navbake.errors import ConfigError, FormatError
from navbake.formats.json_path import shown
from navbake.voxels.placement import check_memory

MAX_VOXELS = 1 << 31  # 1290 along each axis
FREE_BYTES = 256 << 20  # of memory that any file may fill
# and this much more for each of its bytes; an octree of a campus takes some 400
BYTES_PER_BYTE = 512


@dataclass
class VoxelAllowance:
    """A limit on the memory that reading a voxel file takes; what is read is subtracted."""

    source: str
    num_bytes: int  # of the file
    max_voxels: int | None  # as the caller gave it
    memory: float  # that may still be filled [bytes]

    @classmethod
    def of_file(cls, source: str, num_bytes: int, max_voxels: int | None) -> VoxelAllowance:
        """The limit for a file of so many bytes.

        A node of an octree and a byte of an archive can stand for any number of voxels. A file
        may fill `FREE_BYTES`, and `BYTES_PER_BYTE` for each of its bytes, with `MAX_VOXELS` at
        most. If the caller gives `max_voxels`, only that number and free memory are limits.
        """
        if max_voxels is not None and not (isinstance(max_voxels, int) and max_voxels >= 1):
            raise FormatError(f"expected max_voxels to be a whole number >= 1, got {max_voxels!r}")
        memory = FREE_BYTES + BYTES_PER_BYTE * num_bytes if max_voxels is None else math.inf
        return cls(source, num_bytes, max_voxels, memory)

    def take_voxels(self, shape: Sequence[int], itemsize: int) -> None:
        """Count the arrays of a grid, `itemsize` bytes a voxel, or refuse them."""
        most = MAX_VOXELS if self.max_voxels is None else self.max_voxels
        if math.prod(shape) > most:
            counts = " × ".join(shown(int(n)) for n in shape)
            raise FormatError(
                f"too many voxels in {self.source}: {counts}, expected {most:,} at most; pass "
                "max_voxels if that is meant"
            )
        self.take_bytes(math.prod(shape) * itemsize)
        try:
            check_memory(shape, itemsize)
        except ConfigError as error:
            raise FormatError(f"{self.source}: {error}") from None

    def take_bytes(self, num_bytes: int) -> None:
        """Count the bytes of an array, or refuse them."""
        if num_bytes > self.memory:
            raise FormatError(
                f"{self.source} takes more memory than a file of {self.num_bytes:,} bytes may "
                f"fill ({FREE_BYTES + BYTES_PER_BYTE * self.num_bytes:,} bytes); pass max_voxels "
                "if that is meant"
            )
        self.memory -= num_bytes
