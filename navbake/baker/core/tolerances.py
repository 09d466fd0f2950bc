"""Tolerances that several stages share, each for one quantity."""

# Two surfaces of one column that are this close are at one height: float32 meshes that touch differ
# by less [m]
SAME_HEIGHT = 1e-5
# How far a height may exceed a limit, such as a step, and still keep it: what rounding adds [m]
LIMIT_SLACK = 1e-6
# What reaches less far than this into a volume only touches it [m]
TOUCH_DEPTH = 5e-7
