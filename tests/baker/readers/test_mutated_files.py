"""Mutated worlds and robots: each is read, or refused by one line; nothing else, and soon."""

from __future__ import annotations

import random
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from navbake.config.settings import SceneSettings
from navbake.errors import BakeWarning, NavbakeError
from scenes_alone import load_alone

SHAPES = {
    "box": "<box><size>8 6 0.1</size></box>",
    "cone": "<cone><radius>0.3</radius><length>1</length></cone>",
    "outline": "<polyline><height>1.5</height><point>-1 -1</point><point>1 -1</point>"
    "<point>1 1</point><point>0 0</point><point>-1 1</point></polyline>",
    "image": "<image><uri>m.png</uri><scale>0.1</scale><threshold>120</threshold></image>",
    "heights": "<heightmap><uri>m.png</uri><size>4 4 0.3</size><pos>2 0 0</pos></heightmap>",
    "mesh": "<mesh><uri>wedge.obj</uri><scale>0.5 0.5 1</scale></mesh>",
    "plane": "<plane><normal>0 0 1</normal></plane>",
}
COLLISIONS = "\n".join(
    f'<collision name="{name}"><pose>0 1 0 0 0 0</pose><geometry>{shape}</geometry></collision>'
    for name, shape in SHAPES.items()
)
WORLD = f"""<sdf version="1.9"><world name="w"><!-- c -->
<include><uri>model://gone</uri><pose relative_to="house">2 1 0 0 0 1</pose></include>
<frame name="corner" attached_to="house::l"><pose degrees="true">1 1 0 0 0 90</pose></frame>
<model name="house"><static>true</static><link name="l">
{COLLISIONS}
</link></model>
<model name="door"><pose relative_to="corner">0 0 0 0 0 0</pose><link name="l">
<pose rotation_format="quat_xyzw">0.5 0 1 0 0 0 1</pose>
<collision name="c"><geometry><box><size>0.9 0.05 2</size></box></geometry></collision></link>
<joint name="h" type="revolute"><parent>world</parent><child>l</child>
<axis><xyz>0 0 1</xyz><limit><lower>0</lower><upper>1.5</upper></limit></axis></joint></model>
</world></sdf>"""
ROBOT = """<robot name="r">
<link name="base"><collision name="f"><origin xyz="0 0 -0.05" rpy="0 0 0"/>
<geometry><box size="6 5 0.1"/></geometry></collision></link>
<link name="arm"><collision><origin xyz="0 0 1" rpy="0 0 1.57"/><geometry>
<mesh filename="package://here/wedge.obj" scale="0.5 0.5 1"/></geometry></collision></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<origin xyz="-1 1 0.5"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""
NUMBERS = ["nan", "-inf", "1e308", "1e17", "-1", "0", "1e-300", "1e400", "", "1,5", "1e10", "x"]
PIECES = ["<", "&", "\0", "--", "]]>", "<!--", '"', "\x01", "gz:", "<a:b c:d='1'/>", "</a>", "é"]

PYTHON_ERROR = re.compile(r"(Key|Type|Index|Attribute|Runtime)(Error|Warning)")


def mutate(text: str, rng: random.Random) -> str:
    """Replace numbers, drop or repeat lines, swap words, insert markup, or cut the text off."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        lines = text.split("\n")
        line = rng.randrange(len(lines))
        choice = rng.randrange(9)
        numbers = [*re.finditer(r"(?<![\w.])-?\d+\.?\d*", text)]
        words = [*re.finditer(r"[A-Za-z_:]{2,}", text)]
        if choice <= 4 and numbers:
            number = rng.choice(numbers)
            text = text[: number.start()] + rng.choice(NUMBERS) + text[number.end() :]
        elif choice == 5:
            text = "\n".join(lines[:line] + lines[line:][: rng.choice((0, 2))] + lines[line + 1 :])
        elif choice == 6:
            place = rng.randrange(len(text))
            text = text[:place] + rng.choice(PIECES) + text[place:]
        elif choice == 7 and words:
            word = rng.choice(words)
            text = text[: word.start()] + rng.choice(words)[0] + text[word.end() :]
        else:
            text = text[: rng.randrange(len(text) // 2, len(text))]
    return text


@pytest.mark.parametrize(("name", "content"), [("w.sdf", WORLD), ("r.urdf", ROBOT)])
def test_mutated_files_are_read_or_refused_by_one_line(tmp_path: Path, name, content):
    pixels = np.random.default_rng(0).integers(0, 255, (6, 6), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "m.png")
    (tmp_path / "wedge.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\n"
                                        "f 2 3 4\nf 3 1 4\n")  # fmt: skip
    path = tmp_path / name
    path.write_text(content)
    assert len(load_alone(SceneSettings(path=path)).geoms) >= 2
    messages = list[str]()
    for seed in range(120):
        path.write_text(mutate(content, random.Random(seed)))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", BakeWarning)
            try:
                load_alone(SceneSettings(path=path))
            except NavbakeError as error:
                messages.append(str(error))
    assert len(messages) < 110
    assert not [text for text in messages if "\n" in text or PYTHON_ERROR.search(text)]
