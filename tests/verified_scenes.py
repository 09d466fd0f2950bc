"""Scenes that grids are verified against, and grids that can be spoilt."""

from __future__ import annotations

import navbake
from box_worlds import box, world

ROOM = "".join(
    (
        box("floor", -2, -2, -0.1, 2, 2, 0),
        box("wall", -2, 1.9, 0, 2, 2, 2.5),
        box("table", 0.3, -0.5, 0.6, 1.3, 0.2, 0.7),
        '<geom name="ball" type="sphere" size="0.4" pos="-0.9 -0.8 0.4"/>',
        '<geom name="log" type="capsule" size="0.15 0.5" pos="-0.6 0.8 0.3" euler="0 80 25"/>',
        '<geom name="egg" type="ellipsoid" size="0.2 0.3 0.5" pos="1.2 -1.3 0.4"/>',
        '<geom name="drum" type="cylinder" size="0.25 0.4" pos="1 1.2 0.4" euler="20 0 0"/>',
    )
)


def stairs_house() -> str:
    """Two storeys of 5 x 4 m, with a stair of 16 treads of 0.17 m from one to the other."""
    parts = [box("ground floor", 0, 0, -0.2, 5, 4, 0)]
    parts += [box(f"wall {k}", *sides) for k, sides in enumerate(walls(0.0))]
    for k in range(15):
        x = 0.3 + 0.28 * k
        parts.append(box(f"tread {k}", x, 0.1, 0.0, x + 0.28, 1.1, 0.17 * (k + 1)))
    parts.append(box("upper floor", 0, 1.1, 2.52, 5, 4, 2.72))
    parts.append(box("landing", 4.5, 0.1, 2.52, 5, 1.1, 2.72))
    parts += [box(f"upper wall {k}", *sides) for k, sides in enumerate(walls(2.72))]
    return "".join(parts)


def walls(z: float) -> list[tuple[float, ...]]:
    return [
        (-0.1, -0.1, z, 5.1, 0, z + 2.5),
        (-0.1, 4, z, 5.1, 4.1, z + 2.5),
        (-0.1, 0, z, 0, 4, z + 2.5),
        (5, 0, z, 5.1, 4, z + 2.5),
    ]


def write(folder, content: str, name: str = "scene.xml"):
    path = folder / name
    path.write_text(content, encoding="utf-8")
    return path


def of_room(folder, **settings):
    path = write(folder, world(ROOM).replace("<mujoco>", '<mujoco><compiler angle="degree"/>'))
    config = {"scene": {"path": str(path)}, **settings}
    return navbake.bake(config), config


def copy_of(grid):
    """A grid that can be changed without changing the other."""
    levels = [
        level.with_layers(
            weights=level.weights.copy(),
            attributes={name: array.copy() for name, array in level.attributes.items()},
        )
        for level in grid.levels
    ]
    return grid.with_levels(levels)


def kinds_at(report):
    return {(found.kind, found.level, found.cell) for found in report.findings}


SOLID = [(0, 2, 3), (0, 3, 1), (0, 1, 5), (0, 5, 4), (1, 3, 7), (1, 7, 5)]
SOLID += [(3, 2, 6), (3, 6, 7), (2, 0, 4), (2, 4, 6), (4, 5, 7), (4, 7, 6)]


def mesh_room(folder):
    """A mesh file: a floor of 4 x 4 m, a closed box, and one without its lid."""
    sides = [((-2, -2, -0.1), (2, 2, 0)), ((0.23, -1.27, 0.01), (1.07, -0.53, 1.5))]
    sides.append(((-1.47, 0.33, 0.01), (-0.83, 1.17, 1.2)))
    lines = [
        f"v {x} {y} {z}"
        for low, high in sides
        for z in (low[2], high[2])
        for y in (low[1], high[1])
        for x in (low[0], high[0])
    ]
    for number, faces in enumerate((SOLID, SOLID, SOLID[:-2])):
        lines.append(f"o part_{number}")
        lines += ["f " + " ".join(str(v + 8 * number + 1) for v in face) for face in faces]
    config = {"scene": {"path": str(write(folder, "\n".join(lines), "room.obj"))}}
    return navbake.bake(config), config
