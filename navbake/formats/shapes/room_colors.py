"""The colours of rooms in meshes."""

from navbake.formats.shapes.floor_mesh import FloorMesh
from navbake.views.colors import FREE, make_palette, rgb_of

Color = tuple[int, int, int]
"""Red, green and blue, 0 to 255, sRGB."""


def color_rooms(mesh: FloorMesh) -> list[list[Color]]:
    """A colour for each of `LevelMesh.rooms`, by level; each room of the grid has its own."""
    count = [len(level.rooms) - 1 for level in mesh.levels]
    red, green, blue = make_palette(sum(count)).T.tolist()
    colors: list[Color] = list(zip(red, green, blue, strict=True))[1:]
    found = []
    for number in count:
        found.append([rgb_of(FREE), *colors[:number]])
        colors = colors[number:]
    return found
