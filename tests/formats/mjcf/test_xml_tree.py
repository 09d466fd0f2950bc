"""MJCF is read as MuJoCo's parser reads it, also where Python's is stricter."""

from xml.etree import ElementTree

import mujoco
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navbake.formats.mjcf.xml_tree import MOST_DEEP, read_elements, read_leniently

BODY = (
    b'<asset><mesh name="m" file="%s"/></asset><worldbody><geom type="mesh" mesh="m"/></worldbody>'
)
BOX = b"""v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"""


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (b"<mujoco><!-- old -- new -->%s</mujoco>", "m.obj"),
        (b"<mujoco><!-- 45\xb0 -->%s</mujoco>", "m.obj"),
        (b'<mujoco model="a&nbsp;b & c">%s</mujoco>', "m.obj"),
        (b'<mujoco model="a<b>c">%s</mujoco>', "m.obj"),
        (b"<mujoco model='a\"b'>%s</mujoco>", "m.obj"),
        (b'\n<?xml version="1.0"?><mujoco>%s</mujoco>', "m.obj"),
        (b'<?xml version="1.0" encoding="foo"?><mujoco>%s</mujoco>', "m.obj"),
        (b'<?xml version="1.0" encoding="ISO-8859-1"?><mujoco>%s</mujoco>', "é.obj"),
        (b"<mujoco><!-- \xb0 -->%s</mujoco>", "a&amp;b.obj"),
        (b"<mujoco><!-- \xb0 -->%s</mujoco>", "&#109;.obj"),
        (b"<mujoco><!-- a -- b --><!-- <mesh file='n.obj'/> -->%s</mujoco>", "m.obj"),
        (b"<mujoco><!--> <mesh file='n.obj'/> -- -->%s</mujoco>", "m.obj"),
        (b"\xef\xbb\xbf<mujoco ><!-- -- --\n>--\n-->\n%s</mujoco\n>", "m.obj"),
    ],
)
def test_files_are_named_as_mujoco_reads_them(tmp_path, text, name):
    content = text % (BODY % name.encode())
    (tmp_path / "scene.xml").write_bytes(content)
    file = {"a&amp;b.obj": "a&b.obj", "&#109;.obj": "m.obj"}.get(name, name)
    (tmp_path / file).write_bytes(BOX)
    mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert [element.get("file") for element in read_elements(content).iter("mesh")] == [file]


@pytest.mark.parametrize(
    ("text", "tags"),
    [
        (b"", []),
        (b"no XML", []),
        (b"<", []),
        (b"<!-- \xb0", []),
        (b'<a x="1', []),
        (b"<a x=1/>", []),
        (b"<a><b/><c x='\xb0'/><d", ["a", "b", "c"]),
        (b'<a><b/></c><d x="\xb0"/>', ["a", "b"]),
        (b"<a \xb0='1'><b></a>", ["a", "b"]),
        (b'<a xmlns="http://x"><b/></a>', ["a", "b"]),
        (b"<a><![CDATA[<b/>]]><?b <c/>?><d/></a><e/>", ["a", "d"]),
        (b"<a>" * (MOST_DEEP + 9), ["a"] * MOST_DEEP),
    ],
)
def test_the_tree_ends_where_the_xml_is_broken(text, tags):
    root = read_elements(text)
    assert [element.tag for element in ([] if root is None else root.iter())] == tags


@pytest.mark.parametrize(
    "text", [b"<!-- ", b"<a '", b'<a x="', b"<![CDATA[", b"<a>", b"</a>", b"<"]
)
def test_what_has_no_end_takes_no_time(text):
    read_elements(text * 100_000)  # a second for each, were the end looked for from each of them


NAMES = st.sampled_from(["a", "geom", "file", "x-y_z.1"])
TEXTS = st.text(st.sampled_from("a b&<>'\"é/=-\n"), max_size=6)


def trees(children):
    return st.builds(
        build, NAMES, st.dictionaries(NAMES, TEXTS, max_size=3), st.lists(children, max_size=3)
    )


def build(tag, attributes, children):
    element = ElementTree.Element(tag, attributes)
    element.extend(children)
    return element


@given(tree=st.recursive(st.builds(build, NAMES, st.just({}), st.just([])), trees))
def test_both_ways_read_the_same_of_good_xml(tree):
    content = ElementTree.tostring(tree)
    found = read_leniently(content)
    expected = ElementTree.fromstring(content)
    assert [(e.tag, e.attrib, len(e)) for e in found.iter()] == [
        (e.tag, e.attrib, len(e)) for e in expected.iter()
    ]
