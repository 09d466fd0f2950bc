"""What readers take, and what they refuse: only errors of ours, in one line."""

import io
import os

import numpy as np
import pytest

import navbake
from navbake.errors import ConfigError, FormatError, NavbakeError, SceneError
from navbake.formats.shapes import read_room_outlines
from navbake.formats.voxels import encode_binvox, id_table_path
from navbake.voxels.grid import VoxelGrid

GRID = b'{"type": "SceneGrid2D", "width": 2, "height": 1, "cellSize": 1, "min": [0, 0, 0]}'


def voxels(**more):
    values = np.ones((1, 2, 3), dtype=np.uint8)
    return VoxelGrid(values=values, origin=(0.0, 0.0, 0.0), res=1.0, **more)


# ---------------------------------------------------------------- what is no file


@pytest.mark.parametrize(
    "wrong", [None, 3, 1.5, object(), ["a.json"], {}], ids=lambda wrong: type(wrong).__name__
)
def test_what_is_no_path_is_refused(wrong):
    with pytest.raises(FormatError, match="expected a path, a file's content or a file opened"):
        navbake.load(wrong)
    for act in (navbake.load_voxels, voxels().save, navbake.load(GRID).save):
        with pytest.raises(FormatError, match=r"expected a path, got (None|one of Python's type)"):
            act(wrong)


def test_contents_and_streams():
    assert navbake.load(GRID).width == navbake.load(bytearray(GRID)).width == 2
    assert navbake.load(memoryview(GRID)).width == navbake.load(io.BytesIO(GRID)).width == 2
    with pytest.raises(FormatError, match="expected a file opened in binary mode, got text"):
        navbake.load(io.StringIO("{}"))
    with (
        open(os.devnull, "wb") as unreadable,
        pytest.raises(FormatError, match=f"cannot read {os.devnull}: "),
    ):
        navbake.load(unreadable)
    closed = io.BytesIO(GRID)
    closed.close()
    with pytest.raises(FormatError, match=r"cannot read the stream given: .*closed"):
        navbake.load(closed)


@pytest.mark.skipif(not hasattr(os, "symlink"), reason="no links here")
def test_links_that_lead_in_a_circle(tmp_path):
    def loop(name):
        path = tmp_path / name
        path.symlink_to(path)
        return path

    for name in ("a.npz", "a.binvox", "a.bt", "a.ot"):
        with pytest.raises(FormatError, match=r"cannot read .*: Too many levels"):
            navbake.load_voxels(loop(name))
    with pytest.raises(FormatError, match=r"cannot read .*a\.json: Too many levels"):
        navbake.load(loop("a.json"))
    with pytest.raises(FormatError, match=r"cannot read .*a\.geojson: Too many levels"):
        read_room_outlines(loop("a.geojson"))
    for name in ("a.xml", "a.obj", "a.yaml"):
        with pytest.raises(NavbakeError, match=r"Too many levels|no scene file"):
            navbake.bake(loop(name))
    with pytest.raises(FormatError, match="cannot write"):
        navbake.load(GRID).save(tmp_path / "a.json")
    with pytest.raises(FormatError, match="cannot write"):
        voxels().save(tmp_path / "a.npz")


# ---------------------------------------------------------------- tables of IDs


@pytest.fixture
def table(tmp_path):
    """Where the table of a binvox file with IDs is."""
    (tmp_path / "a.binvox").write_bytes(encode_binvox(voxels()))
    return id_table_path(tmp_path / "a.binvox")


def read_names(table):
    return navbake.load_voxels(str(table).removesuffix(".names.json")).names


def test_a_table_that_is_no_text(table):
    table.write_bytes(b'{"ids":{"1":"\xff"}}')
    with pytest.raises(FormatError, match=r"IDs, \S*a\.binvox\.names\.json can't be read"):
        read_names(table)


def test_a_table_that_is_a_folder_or_a_circle(table):
    assert read_names(table) == {}
    table.mkdir()
    with pytest.raises(
        FormatError, match=r"expected a file, got the folder .*a\.binvox\.names\.json"
    ):
        read_names(table)
    table.rmdir()
    table.symlink_to(table)
    with pytest.raises(FormatError, match=r"cannot read .*names\.json: Too many levels"):
        read_names(table)


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        ('{"ids": ' + "[" * 200_000, "can't be read"),
        (
            '{"ids": {"1": ' + "[" * 900 + "]" * 900 + "}}",
            r"Expected `str`, got `array` - at `\$\.ids\[\.\.\.\]`",
        ),
        ('{"ids": {"1": null}}', "Expected `str`, got `null`"),
        ('{"ids": {"1' + "0" * 5000 + '": "a"}}', "can't be read: .*key.*ids"),
        ('{"ids": {"-1": "a"}}', "Expected `int` >= 0 - at `key` in"),
        ('{"ids": {"x": "a"}}', "Expected `int`, got `str` - at `key` in"),
        ('{"ids": []}', "Expected `object`, got `array` - at `\\$.ids`"),
        ("[]", "Expected `object`, got `array`"),
        ("", "can't be read"),
    ],
    ids=lambda text: text[:20],
)
def test_tables_that_are_broken(table, text, culprit):
    table.write_text(text, encoding="utf-8")
    with pytest.raises(FormatError, match=culprit) as caught:
        read_names(table)
    assert "a.binvox.names.json" in str(caught.value) and len(str(caught.value)) < 500


# ---------------------------------------------------------------- messages


def test_messages_are_one_line_whatever_a_file_is_called(tmp_path):
    path = tmp_path / "two\nlines\x1b[31m.yaml"
    with pytest.raises(ConfigError) as caught:
        navbake.bake(path)
    assert str(caught.value).isprintable()
    assert str(caught.value).endswith("two\\nlines\\x1b[31m.yaml")
    assert str(FormatError("half \udc80 of a letter")) == "half \\udc80 of a letter"
    assert str(FormatError("plain é")) == "plain é"


# ---------------------------------------------------------------- names that are not UTF-8


NOT_UTF8 = os.fsdecode(b"k\xfcche")


@pytest.mark.skipif(os.name == "nt", reason="names are Unicode here")
@pytest.mark.parametrize("ending", ["yaml", "xml"])
def test_a_file_that_another_one_names_is_called_in_utf_8(tmp_path, ending):
    with pytest.raises(FormatError, match=r"expected a name in UTF-8.*k\\udcfcche"):
        navbake.load(GRID).convert(tmp_path / f"{NOT_UTF8}.{ending}")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.name == "nt", reason="names are Unicode here")
def test_a_map_of_any_name_can_be_saved_again(tmp_path):
    (path,) = navbake.load(GRID).to_procthor(tmp_path / f"{NOT_UTF8}.png")
    grid = navbake.from_procthor(path)
    grid.save(tmp_path / "a.json")
    assert navbake.load(tmp_path / "a.json").scene_id == "k\ufffdche"


@pytest.mark.skipif(os.name == "nt", reason="names are Unicode here")
@pytest.mark.parametrize("ending", ["xml", "obj"])
def test_a_scene_of_any_name_is_baked_or_its_name_is_the_reason(tmp_path, ending):
    path = tmp_path / f"{NOT_UTF8}.{ending}"
    path.write_text("v 0 0 0\nv 3 0 0\nv 3 3 0\nv 0 3 0\nf 1 2 3 4\n")
    if ending == "obj":
        assert navbake.bake(path, scene={"up": "z"}).scene_id == "k\ufffdche"
    else:
        with pytest.raises(SceneError, match=r"MuJoCo reads paths in UTF-8 only, .*k\\udcfcche"):
            navbake.bake(path)
