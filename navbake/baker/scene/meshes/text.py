"""OBJ, STL and PLY files made ready for trimesh, which reads some of them wrongly in silence."""

import re
from pathlib import Path

from navbake.errors import SceneError

STL_HEADER, STL_TRIANGLE = 84, 50  # [bytes]
MOST_HEADER = 1 << 20  # of a PLY; what counts stands before that [bytes]


def prepare_obj(path: Path) -> bytes:
    """An OBJ's text as trimesh reads it rightly: UTF-8, no indents, absolute indices.

    trimesh counts relative indices from the end of the file, not from where they stand, and
    passes over lines that are indented.

    Raises:
        SceneError: a face counts from 0, or from before the first vertex.
    """
    text = _as_utf8(path.read_bytes()).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    text = text.replace(b"\\\n", b" ")
    if re.search(rb"(?m)^(?:[ \t]+[vf]|[vf]\t)", text):
        text = b"\n".join(b" ".join(line.split()) for line in text.split(b"\n"))
    if not re.search(rb"(?m)^f(?=.*(?:#| -| 0+(?:[/ ]|$)))", text):
        return text
    lines, num_vertices = text.split(b"\n"), 0
    for number, line in enumerate(lines):
        if line.startswith(b"v "):
            num_vertices += 1
        elif line.startswith(b"f "):
            lines[number] = b"f " + b" ".join(
                _absolute(reference, num_vertices, f"line {number + 1} of {path}")
                for reference in line.partition(b"#")[0].split()[1:]
            )
    return b"\n".join(lines)


def _absolute(reference: bytes, num_vertices: int, where: str) -> bytes:
    """A face's reference to a vertex, counted from 1; texture and normal don't matter here."""
    try:
        index = int(reference.partition(b"/")[0])
    except ValueError:
        index = 0
    index = index + num_vertices + 1 if index < 0 else index
    if index <= 0:
        raise SceneError(f"expected numbers of vertices, counted from 1, in {where}")
    return str(index).encode()


def prepare_stl(path: Path) -> bytes:
    """An STL's bytes; refuses one that is cut off, or neither text nor binary."""
    data = path.read_bytes()
    is_solid = data.lstrip()[:5].lower() == b"solid"
    if is_solid and b"facet" in (words := data.lower()):
        num_solids, num_ends = (
            len(re.findall(rb"(?m)^\s*" + word, words)) for word in (b"solid", b"endsolid")
        )
        if num_ends < num_solids:
            raise SceneError(f"{path} is cut off: its last solid has no end")
        return _as_utf8(data)
    count = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
    size = STL_HEADER + STL_TRIANGLE * count
    if len(data) < max(size, STL_HEADER):
        raise SceneError(
            f"{path} is cut off or no STL: expected {size} bytes for the {count} triangles of "
            f"its header, got {len(data)}"
        )
    return data[:size]  # trimesh takes no more, some writers append something


def prepare_ply(path: Path) -> bytes:
    """A PLY's bytes, as UTF-8 if it is text."""
    data = path.read_bytes()
    return _as_utf8(data) if b"format ascii" in data[:200] else data


def check_ply(path: Path, num_vertices: int, num_faces: int) -> None:
    """Refuse a PLY of which trimesh found fewer vertices or triangles than its header says."""
    with path.open("rb") as file:
        header = file.read(MOST_HEADER).partition(b"end_header")[0]
    for name, found in ((b"vertex", num_vertices), (b"face", num_faces)):
        said = re.search(rb"element %s (\d+)" % name, header)
        if said and int(said[1]) > found:
            raise SceneError(
                f"{path} is cut off: expected {int(said[1])} {name.decode()} elements, got {found}"
            )


def _as_utf8(data: bytes) -> bytes:
    """Text that decodes; trimesh needs another package to guess at other encodings."""
    return data.decode("utf-8-sig", errors="replace").encode()
