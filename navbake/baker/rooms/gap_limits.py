"""The limits by which gaps are found, measured and joined, in one table with units and reasons.

`gaps.py` explains the terms. The values were chosen on plans 0 to 99 of `scripts/bench_rooms.py`.
This module imports nothing.
"""

# ------------------------------------------------------------ finding: which lines can be gaps

# The widest gap that separates two rooms, unless the width of doors is given: wider ones lead from
# one part of a room to another [m]
MAX_GAP_WIDTH = 2.5
# The widest mouth of a long passage that is a room of its own, unless doors' width is given [m]
MAX_PASSAGE_WIDTH = 3.2
# The widest opening of a wall that is marked. One that is wider than MAX_GAP_WIDTH separates no
# rooms, but another wall that stops short of it is continued up to its line [m]
MAX_OPENING_WIDTH = 4.0
# The space beside a gap is wider than the gap by this factor, and by at least this much, as walls
# that waver in the lattice widen it by a cell or two [m]
WIDENING_FACTOR = 1.15
MIN_WIDENING = 0.2
# Walls are at most this thick at a doorway: its two ends are no further apart [m]
MAX_WALL_THICKNESS = 0.6
# The lines of one doorway differ in length by up to this, as its jambs waver in the lattice
# [columns]
JAMB_JITTER = 2.0
# A gap goes on in the next column if its middle lies on a line at most this far away [lines]
MAX_LINE_DRIFT = 2
# A smaller space belongs to the gaps beside it: neighbouring lines of gaps leave single cells
# between them where walls are at an angle to the lattice [m²]
MIN_SPACE_AREA = 0.1

# ------------------------------------------------------------ measuring: how wide the spaces are

# A space is measured at these distances behind the gap, and the widest line counts: beyond the
# casing of a doorway, and before the next wall [m]
MEASURING_DEPTHS = (0.1, 0.25, 0.45)
# How far a line runs beyond each end of the gap: what is further away makes the gap no narrower in
# comparison [widths of the gap]
LINE_REACH = 2
# Walls farther from the centres of lines' end cells are ignored: the line ends at something that is
# no wall. Where a line ends at none, it ends half a column from there [columns]
MAX_WALL_DISTANCE = 4.0
# The same of the end cells of doorways, whose jambs lean in the lattice where they are at an angle
# to it; the greater of the two counts [m]
MAX_JAMB_DISTANCE = 0.6

# ------------------------------------------------------------ joining: which spaces are one

# Two spaces are one where the gap between them takes at least this share of the width of the wider
# one, and so of both; these are joined first
JOIN_SHARE_OF_WIDER = 0.8
# … or then this share of the width of the narrower one
JOIN_SHARE_OF_NARROWER = 0.78
# But a passage is a space of its own if it is at least this long [widths of the gap] …
MIN_PASSAGE_LENGTH = 3.0
# … and the space that it opens into is wider than its mouth by this factor
PASSAGE_WIDENING = 1.5
# The shares that decide something
DECIDING_SHARES = (JOIN_SHARE_OF_WIDER, JOIN_SHARE_OF_NARROWER, 1 / PASSAGE_WIDENING)
# Lines are measured up to the walls' geometry at their ends, which is slow, only where this many
# cells more or less could change what a share decides [cells]
DECIDING_CELLS = 2.0
# The width of a gap is compared with limits after this is subtracted, for what rounding adds [m]
WIDTH_ROUNDING = 1e-9

# ------------------------------------------------------------ close calls: what a warning names

# A gap was a close call if its share is this near to JOIN_SHARE_OF_NARROWER, …
CLOSE_SHARE = 0.04
# … the gap is at least this wide [m], and both spaces have at least this area [m²]: of smaller ones
# a user would not miss a room
MIN_CLOSE_WIDTH = 0.8
MIN_CLOSE_AREA = 4.0
