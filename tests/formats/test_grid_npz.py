"""A grid as a NumPy archive: nothing is lost, nothing is run, nothing fills the memory."""

import io
import json
import zipfile

import numpy as np
import pytest

import navbake
from differences import first_difference
from grid_maps import house_from
from map_grids import SAMPLES, sample, small
from navbake.errors import FormatError
from navbake.formats import allowance
from navbake.formats.npz import encode_grid_npz


@pytest.mark.parametrize("name", SAMPLES)
def test_nothing_of_a_sample_is_lost(tmp_path, name):
    grid = sample(name)
    assert grid.to_npz(tmp_path / "a.npz") == [tmp_path / "a.npz"]
    back = navbake.from_npz(tmp_path / "a.npz")
    check_same(grid, back)
    back.to_npz(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def check_same(grid, back):
    assert first_difference(grid, back) is None
    for level, other in zip(grid.levels, back.levels, strict=True):
        for name, array in {"weights": level.weights, **level.attributes}.items():
            there = {"weights": other.weights, **other.attributes}[name]
            assert there.dtype == array.dtype and there.tobytes() == array.tobytes()
        assert list(other.attributes) == list(level.attributes)
        assert other.timings == level.timings and dict(other.user_data) == dict(level.user_data)
        assert other.lattice == level.lattice
    assert back.timings == grid.timings and back.extra == grid.extra
    assert (back.rooms, back.doors, back.steps) == (grid.rooms, grid.doors, grid.steps)
    assert back.level_names == grid.level_names and back.warnings == grid.warnings


def test_a_newer_version_of_the_archive_is_read_with_one_line(tmp_path, caplog):
    (path,) = small().to_npz(tmp_path / "a.npz")
    arrays = dict(np.load(path))
    document = json.loads(arrays["grid"].tobytes())
    document["version"] = 2
    arrays["grid"] = np.frombuffer(json.dumps(document).encode(), np.uint8)
    np.savez(path, **arrays)
    check_same(small(), navbake.from_npz(path))
    (line,) = caplog.messages
    assert "a.npz is by a newer navbake, this is " in line


def odd_grid():
    """What a NavGrid file can't hold, too."""
    level = small(extra={"own": [1, {"a": None}]}, timings={"all": 1.5})
    values = np.arange(15).reshape(3, 5)
    level = level.with_layers(
        weights=level.weights.astype(np.float32),
        attributes={
            "half": values.astype(np.float16),
            "long": values * 2**40,
            "flag": values > 3,
            "weights": values.astype(np.uint8),
            "Tür/a\0b": values.astype(np.int8),
            "nan": np.where(values > 3, np.nan, -0.0),
        },
        user_data={3: {"objects": ["cup", "Tür"]}, 14: {"x": {"y": 1.25}}},
    )
    level.unit = 0.1
    return level


def test_any_dtype_and_any_name_is_kept(tmp_path):
    level = odd_grid()
    level.to_npz(tmp_path / "a.npz")
    back = navbake.from_npz(tmp_path / "a.npz")
    check_same(level, back)
    assert type(back) is type(level)
    house = house_from([small(), odd_grid()], [((0, 0, 0), (1, 0, 1))])
    house.extra, house.timings = {"of": "all"}, {"t": 2}
    house.to_npz(tmp_path / "b.npz")
    check_same(house, navbake.from_npz((tmp_path / "b.npz").read_bytes()))


@pytest.mark.parametrize("levels", [1, 2])
def test_extra_fields_are_none_of_the_format(tmp_path, levels):
    """They could be written to no other file."""
    grid = small() if levels == 1 else house_from([small(), small(ground=3.0)])
    grid.to_npz(tmp_path / "a.npz")
    grid.extra = {"type": "x"}
    with pytest.raises(FormatError, match=r"can't stand in .* `extra.type`"):
        grid.to_npz(tmp_path / "b.npz")
    grid.extra = {"typo": "x"}
    grid.to_npz(tmp_path / "c.npz")


def test_levels_keep_metadata_of_their_own(tmp_path):
    house = house_from([small(), small(ground=3.0)])
    house = navbake.MultiLevelGrid(grids=house.grids, cell_size=0.1, metadata=house.metadata)
    house.grids[1].metadata = {"own": True}
    house.to_npz(tmp_path / "a.npz")
    back = navbake.from_npz(tmp_path / "a.npz")
    assert [level.metadata for level in back.levels] == [level.metadata for level in house.levels]
    assert back.inherits_metadata(0, back.levels[0])
    assert not back.inherits_metadata(1, back.levels[1])


def test_numpy_finds_the_layers_by_name(tmp_path):
    house = sample("house")
    house.to_npz(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        np.testing.assert_array_equal(archive["1/floorHeight"], house.levels[1].floor_height)
        np.testing.assert_array_equal(archive["0/weights"], house.levels[0].weights)
        stated = json.loads(archive["grid"].tobytes())
    assert stated["metadata"]["sceneId"] == house.scene_id


def test_voxels_and_grids_are_told_apart(tmp_path):
    small().to_npz(tmp_path / "grid.npz")
    voxels = navbake.VoxelGrid(values=np.ones((2, 2, 2), bool), origin=(0, 0, 0), res=1.0)
    voxels.save(tmp_path / "voxels.npz")
    with pytest.raises(FormatError, match=r"navbake\.load_voxels reads"):
        navbake.from_npz(tmp_path / "voxels.npz")
    with pytest.raises(FormatError, match=r"navbake\.from_npz reads"):
        navbake.load_voxels(tmp_path / "grid.npz")


# ---------------------------------------------------------------- what is refused


def packed(**changed):
    """The archive of a small grid with some arrays in other forms, or without them."""
    with np.load(io.BytesIO(written())) as archive:
        arrays = {name: archive[name] for name in archive.files}
    arrays |= {name.replace("_", "/"): array for name, array in changed.items()}
    file = io.BytesIO()
    np.savez(file, **{name: array for name, array in arrays.items() if array is not None})
    return file.getvalue()


def written():
    (content,) = encode_grid_npz(small(), "a.npz").values()
    return content


def document(**changed):
    with np.load(io.BytesIO(written())) as archive:
        stated = json.loads(archive["grid"].tobytes())
    for path, value in changed.items():
        *above, key = path.split("__")
        place = stated
        for step in above:
            place = place[int(step) if step.isdigit() else step]
        place[key] = value
    return packed(grid=np.frombuffer(json.dumps(stated).encode(), np.uint8))


@pytest.mark.parametrize(
    ("make", "culprit"),
    [
        (lambda: packed(grid=None), "has no array `grid`"),
        (lambda: document(extra__type=1), "can't stand in for one of .* at `extra.type`"),
        (lambda: document(levels__0__extra={"min": 1}), r"stand in .* at `levels\[0\].extra.min`"),
        (lambda: packed(**{"0_weights": None}), "an array `0/weights`, got nothing"),
        (lambda: packed(**{"0_weights": np.ones((5, 3))}), r"shape \(3, 5\), got float64 of"),
        (lambda: packed(**{"0_weights": np.full((3, 5), "x")}), "expected numbers"),
        (lambda: packed(**{"0_weights": np.full((3, 5), 1j)}), "expected numbers"),
        (lambda: packed(**{"0_userData": np.ones((3, 5))}), "expected text"),
        (lambda: packed(**{"0_userData": np.frombuffer(b'{"99":{}}', np.uint8)}), "0 to 14"),
        (lambda: packed(grid=np.frombuffer(b"{", np.uint8)), "broken JSON"),
        (lambda: packed(grid=np.frombuffer(b"[]", np.uint8)), "expected an object"),
        (lambda: document(type="Grid"), "`type`"),
        (lambda: document(levels=[]), "`levels`"),
        (lambda: document(levels__0__width=-5), r"`levels\[0\]\.width`"),
        (lambda: document(levels__0__width=10**9), "too many cells"),
        (lambda: document(levels__0__min=[0, 0]), r"`levels\[0\]\.min`"),
        (lambda: document(levels__0__min=[1e11, 0, 0]), "of the origin"),
        (lambda: document(levels__0__bbox=[0]), "two corners"),
        (lambda: document(levels__0__cellSize=1e-12), "cells of 1e-09 m or more"),
        (lambda: document(levels__0__attributes=[]), "`levels"),
        (lambda: document(levels__0__attributes__floorHeight=7), "array `0/7`"),
        (lambda: document(metadata__navbake=3), "`metadata.navbake`"),
        (lambda: b"", "a .npz of a grid"),
        (lambda: b"PK\x03\x04", "can't be read"),
        (lambda: written()[:-30], "can't be read"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(make, culprit):
    with pytest.raises(FormatError, match=culprit) as caught:
        _ = dict(navbake.from_npz(make()).user_data)
    assert "\n" not in str(caught.value)


def test_a_pickle_is_not_run():
    class Evil:
        def __reduce__(self):
            return (pytest.fail, ("it was run",))

    file = io.BytesIO()
    np.save(file, np.array([[Evil()]], dtype=object), allow_pickle=True)
    content = io.BytesIO(written())
    with zipfile.ZipFile(content) as old:
        members = {name: old.read(name) for name in old.namelist()}
    for victim in ("0/weights.npy", "grid.npy"):
        bad = io.BytesIO()
        with zipfile.ZipFile(bad, "w") as new:
            for name, data in {**members, victim: file.getvalue()}.items():
                new.writestr(name, data)
        with pytest.raises(FormatError):
            navbake.from_npz(bad.getvalue())


def test_many_long_texts_in_a_short_file_are_refused(tmp_path):
    house = house_from([small(ground=float(k)) for k in range(9)])
    (content,) = encode_grid_npz(house, tmp_path / "a.npz").values()
    blank = np.full(9 << 20, ord(" "), np.uint8)
    blank[:2] = ord("{"), ord("}")
    with np.load(io.BytesIO(content)) as archive:
        arrays = dict(archive)
    assert navbake.from_npz(content).levels[8].width == 5
    changed = io.BytesIO()
    texts = {f"{k}/userData": blank for k in range(9)}
    np.savez_compressed(changed, **(arrays | texts))
    with pytest.raises(FormatError, match=r"more text than a file of .* bytes may unpack to"):
        navbake.from_npz(changed.getvalue())


def test_a_short_file_of_many_zeros_is_refused_before_it_fills_memory(monkeypatch):
    monkeypatch.setattr(allowance, "BASE_MEMORY", 1 << 20)
    level = small()
    num = 1000
    level.width = level.height = num
    level.attributes = {}
    level.weights = np.zeros((num, num), np.uint64)
    (content,) = encode_grid_npz(level, "a.npz").values()
    with pytest.raises(FormatError, match=r"more memory than a file of .* may fill"):
        navbake.from_npz(content)
    assert navbake.from_npz(content, max_cells=num * num).width == num
