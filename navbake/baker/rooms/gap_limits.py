"""The limits for finding and measuring gaps and for joining spaces, with units and reasons.

`gaps.py` explains the terms. The values were tuned on plans 0 to 99 of `scripts/bench_rooms.py`.
This module imports nothing.
"""

# ------------------------------------------------------------ finding: which lines can be gaps

# The widest gap that separates two rooms, unless `rooms.door_width` is set: a wider gap connects
# two parts of one room [m]
MAX_GAP_WIDTH = 2.5
# A long passage is a room of its own if its mouth is at most this wide, unless `rooms.door_width`
# is set [m]
MAX_PASSAGE_WIDTH = 3.2
# The widest opening in a wall that is marked as a gap. An opening that is wider than MAX_GAP_WIDTH
# separates no rooms; but gaps at other walls end at its line [m]
MAX_OPENING_WIDTH = 4.0
# The space beside a gap is wider than the gap by at least this factor, and by at least this length:
# the cells of an oblique wall are uneven by one or two cells [m]
WIDENING_FACTOR = 1.15
MIN_WIDENING = 0.2
# The largest thickness of a wall at a doorway [m]
MAX_WALL_THICKNESS = 0.6
# The lines of cells across a doorway, from jamb to jamb, differ in length by at most this: the
# cells of oblique jambs are uneven [columns]
JAMB_JITTER = 2.0
# A gap continues in the next column if its middle lies at most this far from its middle here,
# counted from the line of cells that the middle here is on [rows]
MAX_MIDDLE_SHIFT = 2
# A smaller space becomes part of the gaps around it: parallel lines of gaps at oblique walls leave
# single cells between them [m²]
MIN_SPACE_AREA = 0.1

# ------------------------------------------------------------ measuring: how wide the spaces are

# The width of a space is measured at these distances behind the gap, and the largest width counts:
# behind a doorway's frame, and before the next wall [m]
MEASURING_DEPTHS = (0.1, 0.25, 0.45)
# How far a line that measures a space goes on beyond each end of the gap [widths of the gap]
MAX_LINE_EXTENSION = 2
# A wall that is farther from the centre of a line's last cell is ignored: the line ends at
# something else, half a column from that centre [columns]
MAX_WALL_DISTANCE = 4.0
# The same limit at the ends of doorways, if it is larger: their jambs may be oblique [m]
MAX_JAMB_DISTANCE = 0.6

# ------------------------------------------------------------ joining: which spaces are one

# A gap's share is its width, divided by that of a space on one side of it. First, two spaces are
# joined if the gap's share of the wider one (and so of both) is at least this …
JOIN_SHARE_OF_WIDER = 0.8
# … then, if its share of the narrower one is at least this
JOIN_SHARE_OF_NARROWER = 0.78
# But a passage is not joined if it is at least this long [widths of the gap] …
MIN_PASSAGE_LENGTH = 3.0
# … and the space that it opens into is wider than its mouth by this factor
PASSAGE_WIDENING = 1.5
# All shares with which a gap's share is compared
DECIDING_SHARES = (JOIN_SHARE_OF_WIDER, JOIN_SHARE_OF_NARROWER, 1 / PASSAGE_WIDENING)
# Measuring lines exactly, up to the walls' geometry, is slow. It is only done if an error of this
# many cells could change a decision [cells]
DECIDING_CELLS = 2.0
# A tolerance for rounding errors that is subtracted from a gap's width before comparisons [m]
WIDTH_ROUNDING = 1e-9

# ------------------------------------------------------------ close calls: what a warning names

# A gap is a close call if its share differs from JOIN_SHARE_OF_NARROWER by at most this, …
CLOSE_SHARE = 0.04
# … the gap is at least this wide [m], and both spaces have at least this area [m²]: smaller ones
# don't matter to users
MIN_CLOSE_WIDTH = 0.8
MIN_CLOSE_AREA = 4.0
