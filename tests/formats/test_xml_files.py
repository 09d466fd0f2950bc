"""XML as TinyXML-2 reads it, which Gazebo, ROS and MuJoCo use."""

from __future__ import annotations

import time

import pytest

from navbake.formats.xml_files import find_root_tag, parse_xml

WELL_FORMED = """<?xml version="1.0"?>
<!DOCTYPE a>
<!-- one -->
<a b='1 &lt; 2' c="&#65;&#x42;">text &amp; more<![CDATA[<raw> & ]]>
  <d/><e f="&quot;">x</e >tail
</a>
"""


def flatten(content):
    return [(e.tag, e.attrib, e.text, e.tail) for e in parse_xml(content).iter()]


def test_both_parsers_agree_on_well_formed_files():
    """What expat reads, the forgiving parser reads alike."""
    expected = flatten(WELL_FORMED.encode())
    assert expected[0][1] == {"b": "1 < 2", "c": "AB"}
    forgiving = f"\n{WELL_FORMED}"  # a declaration after a blank line is refused by expat
    assert flatten(forgiving.encode()) == expected
    assert flatten(forgiving.replace("\n", "\r\n").encode()) == expected
    assert flatten(WELL_FORMED.replace("UTF-8", "UTF-16").encode("utf-16")) == expected


@pytest.mark.parametrize(
    "content",
    [
        "<a><!-- x -- y --><b/></a>",
        "<a><gz:c gz:d='1'/><b/></a>",
        "<a>R & D &nbsp;<b/></a>",
        "<a><b/></a><!-- cut off",
        "<a><b/></a>more<c>",
        " \n<?xml version='1.0'?><a><b/></a>",
        "<a x='1' x='2'><b/></a>",
        "<a x='<'><b/></a>",
        "<a>\x01<b/></a>",
    ],
)
def test_what_the_standard_refuses_is_read(content):
    root = parse_xml(content.encode())
    assert root.tag == "a" and root.find("b") is not None
    assert find_root_tag(content.encode()) == "a"
    assert parse_xml(b"<a \xff='1'>\xe9</a>").text == "\ufffd"
    assert parse_xml(b"<a:b xmlns:c='d'><c:e/></a:b>")[0].tag == "c:e"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "line 1: the file ends without an element"),
        ("no markup", "the file ends without an element"),
        ("<a>\n<b>", "line 2: the file ends without </b>"),
        ("<a>\n</b>", "line 2: expected </a>, got </b>"),
        ("</a>", "expected an element, got </a>"),
        ("<a b>", "expected an attribute or > in <a>, got 'b>'"),
        ("<a b=1/>", "expected an attribute or > in <a>, got 'b=1/>'"),
        ("<a b='1/>", "expected an attribute or > in <a>"),
        ("<a><1/></a>", "expected the name of an element, got '<1/></a>'"),
        ("<a><!-- ", "expected --> after <!--"),
        ("<a><![CDATA[ ", "expected ]]> after <![CDATA["),
        ("<a>" * 501, "more than 500 elements in elements"),
    ],
)
def test_broken_files_are_one_line(content, reason):
    with pytest.raises(ValueError, match="line") as error:
        parse_xml(content.encode())
    assert reason in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    "piece", ["<!--", "<a>", "<a ", "<a b='", "&", "<![CDATA[", "<!", "a=", " ", "</a>", "<a/>"]
)
def test_time_is_linear_in_the_size(piece):
    start = time.process_time()
    with pytest.raises(ValueError, match="line 1"):
        parse_xml(b"<r>" + piece.encode() * 100_000)
    assert time.process_time() - start < 5


def test_entities_that_expand_without_end_stay_as_they_are():
    entities = '<!ENTITY e0 "0123456789">' + "".join(
        f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 10)
    )
    start = time.process_time()
    assert parse_xml(f"<!DOCTYPE a [{entities}]><a>&e9;</a>".encode()).text == "&e9;"
    assert time.process_time() - start < 5
