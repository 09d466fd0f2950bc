"""Kitchens with counters, drawers, an island, cupboards and things on them, drawn at random."""

from __future__ import annotations

import numpy as np

COUNTER_DEPTH = 0.6
COUNTER_HEIGHT = 0.9
PLATE = 0.04  # thickness of a worktop


def make_kitchen(seed: int) -> str:
    """An MJCF of a kitchen; drawers, cups and appliances are bodies of their own names."""
    rng = np.random.default_rng(seed)
    width, depth = rng.uniform(3.2, 5.2), rng.uniform(3.0, 5.0)
    bodies: list[str] = []

    def add(name: str, *geoms: str, joint: str = "") -> None:
        bodies.append(f'<body name="{name}">{joint}{"".join(geoms)}</body>')

    def box(low, high) -> str:
        low, high = np.asarray(low, float), np.asarray(high, float)
        middle, half = (low + high) / 2, (high - low) / 2
        return (
            f'<geom type="box" pos="{" ".join(f"{v:.5f}" for v in middle)}"'
            f' size="{" ".join(f"{v:.5f}" for v in half)}"/>'
        )

    x = [-width / 2, width / 2]
    y = [-depth / 2, depth / 2]
    thickness = 0.15
    walls = [
        ((x[0] - thickness, y[0] - thickness, 0), (x[0], y[1] + thickness, 2.6)),
        ((x[1], y[0] - thickness, 0), (x[1] + thickness, y[1] + thickness, 2.6)),
        ((x[0], y[1], 0), (x[1], y[1] + thickness, 2.6)),
        ((x[0], y[0] - thickness, 0), (x[0] + 1.2, y[0], 2.6)),
        ((x[0] + 2.1, y[0] - thickness, 0), (x[1], y[0], 2.6)),
    ]
    for number, (low, high) in enumerate(walls):
        add(f"wall_{number}", box(low, high))
    # a row of units along the wall in the north: carcass, worktop, drawers before the carcass
    unit_width = 0.6
    num_units = int((width - 0.8) // unit_width)
    front = y[1] - COUNTER_DEPTH
    for unit in range(num_units):
        left = x[0] + unit * unit_width
        carcass = box((left, front + 0.02, 0.1), (left + unit_width, y[1], COUNTER_HEIGHT - PLATE))
        top = box(
            (left, front - 0.02, COUNTER_HEIGHT - PLATE), (left + unit_width, y[1], COUNTER_HEIGHT)
        )
        add(f"counter_{unit + 1}", carcass, top)
        for drawer in range(rng.integers(0, 4)):
            low = 0.15 + drawer * 0.22
            add(
                f"drawer_{unit + 1}_{drawer + 1}",
                box((left + 0.01, front, low), (left + unit_width - 0.01, front + 0.02, low + 0.2)),
                joint='<joint type="slide" axis="0 -1 0" range="0 0.4" limited="true"/>',
            )
        if rng.random() < 0.5:
            add(
                f"cabinet_{unit + 1}",
                box((left, y[1] - 0.35, 1.45), (left + unit_width, y[1], 2.1)),
            )
        for cup in range(rng.integers(0, 3)):
            at_x = left + rng.uniform(0.1, unit_width - 0.1)
            at_y = front + rng.uniform(0.1, COUNTER_DEPTH - 0.15)
            add(
                f"cup_{unit + 1}_{cup + 1}",
                f'<geom type="cylinder" size="0.04 0.05"'
                f' pos="{at_x:.4f} {at_y:.4f} {COUNTER_HEIGHT + 0.05:.4f}"/>',
                joint="<freejoint/>",
            )
    fridge = x[0] + num_units * unit_width
    add("fridge", box((fridge + 0.02, y[1] - 0.65, 0), (fridge + 0.62, y[1], 1.9)))
    # an island that isn't parallel to the walls
    turn = rng.uniform(-0.6, 0.6)
    half = np.array([rng.uniform(0.4, 0.8), rng.uniform(0.25, 0.45)])
    middle = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.6, 0.0)])
    pose = f'pos="{middle[0]:.4f} {middle[1]:.4f} {COUNTER_HEIGHT / 2}" euler="0 0 {turn:.4f}"'
    add(
        "island",
        f'<geom type="box" size="{half[0]:.4f} {half[1]:.4f} {COUNTER_HEIGHT / 2}" {pose}/>',
    )
    for bowl in range(rng.integers(1, 4)):
        offset = rng.uniform(-0.8, 0.8, 2) * half
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        at = middle + rotation @ offset
        add(
            f"bowl_{bowl + 1}",
            f'<geom type="ellipsoid" size="0.09 0.07 0.05"'
            f' pos="{at[0]:.4f} {at[1]:.4f} {COUNTER_HEIGHT + 0.05}"/>',
            joint="<freejoint/>",
        )
    for stool in range(rng.integers(0, 4)):
        at = np.array([rng.uniform(x[0] + 0.3, x[1] - 0.3), rng.uniform(y[0] + 0.3, y[0] + 0.9)])
        add(
            f"stool_{stool + 1}",
            f'<geom type="cylinder" size="0.17 0.3" pos="{at[0]:.4f} {at[1]:.4f} 0.3"/>',
            joint="<freejoint/>",
        )
    floor = (
        f'<geom name="floor" type="box" pos="0 0 -0.1"'
        f' size="{width / 2 + 1.5:.3f} {depth / 2 + 1.5:.3f} 0.1"/>'
    )
    return (
        f'<mujoco model="kitchen_{seed}"><compiler angle="radian"/><worldbody>'
        f"{floor}{''.join(bodies)}</worldbody></mujoco>"
    )
