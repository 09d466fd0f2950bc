"""What would crash MuJoCo's compiler, or keep it busy for hours, is refused before it runs."""

from __future__ import annotations

import os
import struct

import pytest

import navbake
from navbake.baker.scene.guard.oversized import refuse_oversized
from navbake.errors import SceneError

BALL = '<geom size=".1"/>'


def scene(tmp_path, world=BALL, assets="", top="", name="scene.xml"):
    path = tmp_path / name
    path.write_text(f"<mujoco>{top}<asset>{assets}</asset><worldbody>{world}</worldbody></mujoco>")
    return path


def texture(width, height, kind="2d", more=""):
    return (
        f'<texture name="t" type="{kind}" builtin="flat" width="{width}" height="{height}" {more}/>'
    )


def replicate(count, inside=BALL):
    return f'<replicate count="{count}" offset="1 0 0">{inside}</replicate>'


TOO_LARGE = [
    (
        {"assets": texture(60000, 60000)},
        r"1,073,741,824 bytes of textures, got 10,800,000,000 at 't'",
    ),
    ({"assets": texture(10000, 10000) * 4}, "bytes of textures, got 1,200,000,000"),
    ({"assets": texture(20000, 1, kind="cube")}, "bytes of textures, got 7,200,000,000"),
    (
        {"assets": texture(20000, 20000, more='nchannel="4"')},
        "bytes of textures, got 1,600,000,000",
    ),
    (
        {"world": replicate(1_000_000)},
        "at most 100,000 elements made by <replicate>, got 1,000,000",
    ),
    ({"world": replicate(1000, replicate(1000))}, "elements made by <replicate>, got 1,00"),
    (
        {"world": replicate(1000, f"<body>{replicate(500)}</body>")},
        "elements made by <replicate>, got",
    ),
    ({"world": replicate(30_000, BALL * 4)}, "elements made by <replicate>, got 120,000"),
    ({"assets": '<hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/>'}, "height field"),
    ({"world": '<flexcomp name="f" type="grid" count="1000 1000 1000"/>'}, "of a <flexcomp>"),
    ({"world": '<composite type="cable" count="2000000 1 1"/>'}, "of a <composite>"),
    ({"top": '<size nkey="2000000000"/>'}, "`nkey` of <size>"),
]


@pytest.mark.parametrize(("parts", "culprit"), TOO_LARGE)
def test_refuses(tmp_path, parts, culprit):
    path = scene(tmp_path, **parts)
    with pytest.raises(SceneError, match=culprit) as caught:
        refuse_oversized(path)
    assert "scene.xml" in str(caught.value)


def test_a_bake_refuses_before_mujoco_sees_it(tmp_path, monkeypatch):
    monkeypatch.setattr("mujoco.MjModel.from_xml_path", None)
    for parts, culprit in TOO_LARGE[:1] + TOO_LARGE[4:6]:
        with pytest.raises(SceneError, match=culprit):
            navbake.bake(scene(tmp_path, **parts))


def test_what_an_included_file_holds_is_made_as_often(tmp_path):
    """Also where nothing in it would ask for anything by itself."""
    (tmp_path / "inner.xml").write_text(f"<mujoco>{BALL * 200}</mujoco>")
    path = scene(tmp_path, world=replicate(1000, '<include file="inner.xml"/>'))
    with pytest.raises(SceneError, match=r"elements made by <replicate>, got .* in .*inner\.xml"):
        refuse_oversized(path)


def test_included_files_count_as_often_as_they_are_made(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "inner.xml").write_text(f"<mujoco>{replicate(1000)}</mujoco>")
    (tmp_path / "parts" / "outer.xml").write_text('<mujoco><include file="inner.xml"/></mujoco>')
    path = scene(tmp_path, world=replicate(1000, '<include file="parts/outer.xml"/>'))
    with pytest.raises(SceneError, match=r"elements made by <replicate>, got .* in .*inner\.xml"):
        refuse_oversized(path)


@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"assets": texture(4096, 4096) * 3},
        {"assets": texture(512, 3072, kind="cube")},
        {"assets": texture(20000, 1, kind="cube", more='gridsize="3 4"')},
        {"world": replicate(100, replicate(100))},
        {"world": '<include file="scene.xml"/>'},
        {"world": '<include file="none.xml"/>'},
        {"world": '<replicate count="many"/>', "assets": '<texture width="1e999" height="x"/>'},
        {"top": '<size memory="100M" nkey="3"/>'},
    ],
)
def test_leaves_the_rest_to_mujoco(tmp_path, parts):
    refuse_oversized(scene(tmp_path, **parts))


def png(width, height, size):
    head = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR" + struct.pack(">2I", width, height)
    return head + bytes(size - len(head))


@pytest.mark.parametrize(("kind", "most"), [("hfield", "4,016,000"), ("texture", "32,256,000")])
@pytest.mark.parametrize("folder", ["", "assets", "deep/assets"])
def test_images_that_unpack_to_much_are_refused(tmp_path, kind, most, folder):
    (tmp_path / folder).mkdir(parents=True, exist_ok=True)
    more = 'size="1 1 1 1"' if kind == "hfield" else 'type="2d"'
    assets = f'<{kind} name="t" file="a.png" {more}/>'
    top = f'<compiler assetdir="{folder}"/>' if folder else ""
    path = scene(tmp_path, assets=assets, top=top)
    image = tmp_path / folder / "a.png"
    image.write_bytes(png(20_000, 20_000, 1000))
    with pytest.raises(SceneError, match=f"at most {most} pixels of an image of 1,000 bytes"):
        refuse_oversized(path)
    image.write_bytes(png(4000, 4000, 1_000_000))  # as a photo has
    refuse_oversized(path)
    for content in (b"", png(9, 9, 24)[:20], b"x" * 100):
        image.write_bytes(content)
        refuse_oversized(path)
    image.unlink()
    refuse_oversized(path)


@pytest.mark.parametrize("comment", ["<!-- a -- b -->", '<!-- "a -->', "<!-- \udcb0 -->"])
def test_looks_into_xml_that_python_refuses(tmp_path, comment):
    path = scene(tmp_path, assets=texture(60_000, 60_000))
    content = path.read_bytes().replace(b"<asset>", os.fsencode(comment) + b"<asset>")
    assert content.count(b"<!--") == 1
    path.write_bytes(content)
    with pytest.raises(SceneError, match="bytes of textures"):
        refuse_oversized(path)


def test_what_an_attached_model_includes_counts_from_its_folder(tmp_path):
    """As MuJoCo has it, whichever folder the including file is in."""
    (tmp_path / "robot" / "parts").mkdir(parents=True)
    for name, text in (
        ("robot/robot.xml", '<mujoco><include file="parts/arm.xml"/></mujoco>'),
        ("robot/parts/arm.xml", '<mujoco><include file="skin.xml"/></mujoco>'),
        ("robot/skin.xml", f"<mujoco><asset>{texture(60_000, 60_000)}</asset></mujoco>"),
    ):
        (tmp_path / name).write_text(text)
    path = scene(tmp_path, assets='<model name="r" file="robot/robot.xml"/>')
    with pytest.raises(SceneError, match=r"bytes of textures, got .*skin\.xml"):
        refuse_oversized(path)


def test_leaves_broken_xml_to_mujoco(tmp_path):
    for text in ("<mujoco>", "", "\0", '<?xml version="1.0" encoding="none"?><a/>'):
        (tmp_path / "scene.xml").write_text(text)
        refuse_oversized(tmp_path / "scene.xml")
