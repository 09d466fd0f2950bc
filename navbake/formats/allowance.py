"""What a stranger's file may cost: cells, bytes and memory, for all readers of `formats`.

NavGrids, maps, voxels, images and arrays are published, and a few bytes of one may claim to stand
for more than any memory holds: runs have any length, and packed data unpack a thousandfold. So a
reader makes one `Allowance` for the file, and takes from it whatever it is about to reserve, before
it does. What users write themselves (settings, lists, outlines of rooms) has no such limit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from navbake.errors import ConfigError, FormatError
from navbake.formats.values import JsonPath, shown

MAX_BYTES = 4 << 30  # of any file
MAX_CELLS = 100_000_000  # of all levels together
MAX_VOXELS = 1 << 31  # 1290 along each axis
MAX_PIXELS = 80_000_000  # below the number from which Pillow warns of a decompression bomb
FREE_BYTES = 256 << 20  # of memory that any file may fill
# and this much more for each of its bytes; a campus as an octree takes 400, house-100 as JSON 40
BYTES_PER_BYTE = 512
BYTES_PER_CELL = 128  # of all arrays together, where a caller says how many cells there may be
TEXT_COST = 4  # bytes of memory that count for one of packed JSON: its values take more
PIXEL_COST = 6  # bytes of memory for a pixel: an image, a copy, and what its values are made of


@dataclass
class Allowance:
    """What reading a file may still reserve.

    Attributes:
        num_bytes: size of the file.
        keyword: the argument by which a caller of the reader raises the limit, "" for none.
        most: what that argument said, None where it was left out.
        cells: cells, voxels or pixels that may still come.
        memory: that arrays may still fill [bytes].
        text: JSON that may still be unpacked [bytes].
    """

    num_bytes: int
    keyword: str
    most: int | None
    cells: int
    memory: float
    text: int

    @classmethod
    def of_grid(cls, num_bytes: int, max_cells: int | None = None) -> Allowance:
        """The limits for a grid's file of so many bytes."""
        cells = MAX_CELLS if max_cells is None else max_cells
        rule = FREE_BYTES + BYTES_PER_BYTE * num_bytes
        memory = rule if max_cells is None else BYTES_PER_CELL * max_cells
        return cls(num_bytes, "max_cells", max_cells, cells, memory, rule // TEXT_COST)

    @classmethod
    def of_voxels(cls, num_bytes: int, max_voxels: int | None = None) -> Allowance:
        """The limits for a voxel file; with `max_voxels`, free memory is the other limit."""
        if max_voxels is not None and not (isinstance(max_voxels, int) and max_voxels >= 1):
            raise FormatError(f"expected max_voxels to be a whole number >= 1, got {max_voxels!r}")
        cells = MAX_VOXELS if max_voxels is None else max_voxels
        memory = FREE_BYTES + BYTES_PER_BYTE * num_bytes if max_voxels is None else math.inf
        return cls(num_bytes, "max_voxels", max_voxels, cells, memory, 0)

    @classmethod
    def of_image(cls, num_bytes: int) -> Allowance:
        """The limits for an image."""
        return cls(num_bytes, "", None, MAX_PIXELS, FREE_BYTES + BYTES_PER_BYTE * num_bytes, 0)

    def take_cells(self, shape: Sequence[int], place: JsonPath) -> None:
        """Count the cells, voxels or pixels of a shape, or refuse them."""
        if math.prod(shape) > self.cells:
            unit = self.keyword.removeprefix("max_") or "pixels"
            counts = " × ".join(shown(int(n)) for n in shape)
            place.fail(f"too many {unit} ({counts}, expected {self.cells:,} at most)", self._remedy)
        self.cells -= math.prod(shape)

    def take_array(self, shape: Sequence[int], itemsize: int, place: JsonPath) -> None:
        """Count the memory of an array, or refuse it."""
        num_bytes = math.prod(shape) * itemsize
        if num_bytes > self.memory:
            rule = f"{self.keyword} = {self.most} allows"
            if self.most is None:
                whole = FREE_BYTES + BYTES_PER_BYTE * self.num_bytes
                rule = f"a file of {self.num_bytes:,} bytes may fill ({whole:,} bytes)"
            place.fail(f"more memory than {rule}", self._remedy)
        self.memory -= num_bytes
        if self.keyword == "max_voxels":
            from navbake.voxels.placement import check_memory  # loads numpy

            try:
                check_memory(shape, itemsize)
            except ConfigError as error:
                raise FormatError(f"{place.file}: {error}") from None

    def take_text(self, num_bytes: int, place: JsonPath) -> None:
        """Count JSON that a packed file unpacks to, or refuse it."""
        self.text -= num_bytes
        if self.text < 0:
            what = f"more text than a file of {self.num_bytes:,} bytes may unpack to"
            place.fail(what, "unpack it first if that is meant")

    @property
    def _remedy(self) -> str:
        return f"pass {self.keyword} if that is meant" if self.keyword else ""
