"""The command `navbake map-descriptor`, which `mdf` calls, too."""

import json

import numpy as np
import pytest

P1 = "FFC07F80FF01FE03FFFFFFF3FFE7FFCFFF9C7F38FE71FCE3F87FF0FFE1FFC3FF87FF0E0E1C1F"
P2 = "00000100001C80000000001C0000080000060001C00000080000"


def test_a_baked_arena_as_a_descriptor(arena, run):
    run("bake", "arena.yaml", "-q")
    status, out, err = run("map-descriptor", "arena.grid.json")
    assert (status, err) == (0, "")
    part1, part2, *drawing = out.strip().split("\n")
    assert part1 == "F" * 76 and len(part2) == 76
    assert len(drawing) == 20 and {len(row) for row in drawing} == {15}
    assert drawing[17] == "...........##.." and drawing[3] == ".####.........."
    status, again, _ = run("mdf", "--decode", part1, part2)
    assert again.strip().split("\n") == drawing


def test_part_of_a_level_with_a_mask(arena, run):
    run("bake", "arena.yaml", "-q", "--set", "grid.cell_size=0.05")
    mask = np.zeros((4, 5), dtype=bool)
    mask[3, 3:] = True
    np.save("seen.npy", mask)
    status, out, _ = run(
        "mdf", "arena.grid.json", "--corner", 0.8, 0.2, "--rows", 4, "--cols", 5,
        "--explored", "seen.npy", "--json",
    )  # fmt: skip
    facts = json.loads(out)
    assert status == 0 and facts["map"] == ["?????", "?????", "?????", "???##"]
    assert (facts["rows"], facts["cols"]) == (4, 5)


def test_decodes_the_canonical_descriptor(run):
    status, out, _ = run("mdf", "--decode", P1, P2)
    assert status == 0 and out.count("?") == 92 and out.count("#") == 15


@pytest.mark.parametrize(
    ("arguments", "status", "culprit"),
    [
        ((), 2, "expected a GRID, or --decode"),
        (("arena.grid.json", "--rows", 3), 2, "both or none"),
        (("arena.grid.json", "--level", 4), 1, "no level 4 in arena.grid.json: it has 1"),
        (("arena.grid.json", "--explored", "no.npy"), 1, "cannot read no.npy"),
        (
            ("arena.grid.json", "--explored", "several.npz"),
            1,
            "in several.npz",
        ),
        (("arena.grid.json", "--square", 1e-7), 1, "larger squares"),
        (("--decode", P1, P2 + "0"), 1, "in part 2"),
        (("none.json",), 1, "none.json"),
    ],
)
def test_wrong_descriptors_say_what_is_wrong(arena, run, arguments, status, culprit):
    run("bake", "arena.yaml", "-q")
    np.savez("several.npz", np.ones((3, 3)))
    found, _, err = run("mdf", *arguments)
    assert found == status and culprit in " ".join(err.split())
