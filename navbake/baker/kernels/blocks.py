"""Blocks of cells, as kernels find them."""

from navbake.compiled import part

SIZE = 64  # cells along a block's edge


@part(inline="always")
def block_window(lattice, block):
    """The rows and columns of a block: the first row, past the last, and so with the columns."""
    cols = (lattice.width + SIZE - 1) // SIZE
    row, col = block // cols * SIZE, block % cols * SIZE
    return row, min(row + SIZE, lattice.height), col, min(col + SIZE, lattice.width)


@part(inline="always")
def block_of(lattice, row, col):
    """The block that holds a cell."""
    return row // SIZE * ((lattice.width + SIZE - 1) // SIZE) + col // SIZE
