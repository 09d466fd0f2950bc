"""Scenes of batches: good ones, ten kinds of broken ones, and three that end their process."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mujoco

# an OBJ mesh: a tetrahedron of the given height
CHEST = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 {height}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
FLOOR = '<geom type="box" size="{half} {half} .1" pos="0 0 -.1"/>'


class Expected(NamedTuple):
    """What is to become of a scene: ``ok``, or how it fails and a part of the reason."""

    how: str
    why: str = ""


def write_scenes(
    folder: Path, count: int, broken: int = 0, half: float = 2.0, endings: bool = False
) -> dict[str, Expected]:
    """Write scenes and ``list.jsonl``, which names them; what is to become of each, by id.

    Args:
        count: how many good ones, of boxes on a floor that is four times `half` squared [m²].
        broken: how many broken ones, of the ten kinds in turn.
        endings: whether there are one that hangs, one that takes 30 GiB and one that crashes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    expected: dict[str, Expected] = {}
    for number in range(count):
        name = f"good-{number:04}"
        (folder / f"{name}.xml").write_text(draw_room(number, half))
        rows.append({"scene": f"{name}.xml"})
        expected[name] = Expected("ok")
    for number in range(broken):
        make, why = BROKEN[number % len(BROKEN)]
        name = f"broken-{number:02}"
        rows.append({"scene": make(folder, name), "id": name})
        expected[name] = Expected("error", why)
    if endings:
        for name, ending, how in ENDINGS:
            rows.append({"scene": ending(folder, name), "id": name})
            expected[name] = how
    random.Random(0).shuffle(rows)
    lines = "".join(json.dumps(row) + "\n" for row in rows)
    (folder / "list.jsonl").write_text(lines)
    return expected


def draw_room(seed: int, half: float = 2.0) -> str:
    """MJCF of a floor with boxes at random places."""
    random_ = random.Random(seed)
    boxes = "".join(
        f'<geom type="box" size=".2 .3 .4" pos="{random_.uniform(-half, half):.3f} '
        f'{random_.uniform(-half, half):.3f} .4"/>'
        for _ in range(5)
    )
    return f"<mujoco><worldbody>{FLOOR.format(half=half)}{boxes}</worldbody></mujoco>"


def _write(name: str, text: str) -> Callable[[Path, str], str]:
    """Returns what writes a file and gives its name."""

    def write(folder: Path, stem: str) -> str:
        (folder / f"{stem}{name}").write_text(text.replace("STEM", stem))
        return f"{stem}{name}"

    return write


def _with_settings(text: str) -> Callable[[Path, str], str]:
    def write(folder: Path, stem: str) -> str:
        (folder / f"{stem}.xml").write_text(draw_room(0))
        return _write(".yaml", text)(folder, stem)

    return write


def _write_broken_mesh(folder: Path, stem: str) -> str:
    (folder / f"{stem}.stl").write_bytes(b"\0" * 80 + b"\xff\xff\xff\x7f" + b"\1" * 100)
    mesh = f'<asset><mesh name="m" file="{stem}.stl"/></asset>'
    text = f'<mujoco>{mesh}<worldbody><geom type="mesh" mesh="m"/></worldbody></mujoco>'
    return _write(".xml", text)(folder, stem)


# how a scene is written, and what the reason of its failure has in it
BROKEN: list[tuple[Callable[[Path, str], str], str]] = [
    (_write(".xml", "<mujoco><worldbody>"), "broken XML"),
    (lambda folder, stem: f"{stem}.xml", "no scene file"),
    (_write(".xml", "<mujoco><worldbody><gemo/></worldbody></mujoco>"), "gemo"),
    (
        _write(".xml", '<mujoco><asset><mesh file="no.stl"/></asset></mujoco>'),
        "no.stl",
    ),
    (_write(".xml", '<mujoco><include file="no-such.xml"/></mujoco>'), "no-such.xml"),
    (_write(".xml", "<mujoco><worldbody/></mujoco>"), "nothing to bake"),
    (
        _write(
            ".xml", '<mujoco><worldbody><geom type="box" size="9e3 9e3 1"/></worldbody></mujoco>'
        ),
        "grid.max_cells",
    ),
    (_with_settings("scene: {path: STEM.xml}\ngrid: {cell_size: 5cm}\n"), "5cm"),
    (_with_settings("scene: {path: STEM.xml\n"), "line"),
    (_write_broken_mesh, ".stl"),
]


def _write_hanging(folder: Path, stem: str) -> str:
    """Copies of a body, which MuJoCo compiles for minutes: its time grows as their square."""
    body = '<body><geom type="box" size="1 1 1"/></body>'
    many = f'<replicate count="60000" offset="1 0 0">{body}</replicate>'
    return _write(".xml", f"<mujoco><worldbody>{many}</worldbody></mujoco>")(folder, stem)


def _write_taking(folder: Path, stem: str) -> str:
    """A floor of 36 km², whose settings allow that: an array of its cells has 27 GiB."""
    (folder / f"{stem}.xml").write_text(
        f"<mujoco><worldbody>{FLOOR.format(half=3000)}</worldbody></mujoco>"
    )
    settings = f"scene: {{path: {stem}.xml}}\ngrid: {{max_cells: 100000000000}}\n"
    return _write(".yaml", settings)(folder, stem)


def _write_crashing(folder: Path, stem: str) -> str:
    """A compiled model with an index that MuJoCo doesn't check, and follows out of its memory."""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{FLOOR.format(half=2)}<body><joint/><geom size=".1"/></body>'
        "</worldbody></mujoco>"
    )
    model.body_treeid[-1] = 1 << 30
    mujoco.mj_saveModel(model, str(folder / f"{stem}.mjb"), None)
    return f"{stem}.mjb"


ENDINGS = (
    ("hangs", _write_hanging, Expected("too long", "it took more than")),
    ("takes", _write_taking, Expected("too large", "it took more memory than")),
    ("crashes", _write_crashing, Expected("crashed", "its process ended by SIGSEGV")),
)


def wrong_rows(rows: list[dict[str, Any]], expected: dict[str, Expected]) -> list[str]:
    """What is not as expected, a line each."""
    found = {row["id"]: row for row in rows}
    wrong = [f"{name}: no row" for name in expected.keys() - found.keys()]
    for name, row in found.items():
        how = row.get("how", row["status"])
        wanted = expected[name]
        if how != wanted.how or wanted.why not in row.get("error", ""):
            wrong.append(f"{name}: expected {wanted}, got {how}: {row.get('error')}")
    return wrong
