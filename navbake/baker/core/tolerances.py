"""Tolerances that several stages share, each for one quantity."""

# Two surfaces over one point are at the same height if they differ by at most this: float32 meshes
# that touch differ by less [m]
SAME_HEIGHT = 1e-5
# A length keeps a limit, such as the highest step, if it exceeds it by at most this: rounding adds
# less [m]
LIMIT_SLACK = 1e-6
# A shape that reaches into a volume by less than this only touches it [m]
TOUCH_DEPTH = 5e-7
