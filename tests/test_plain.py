"""The package is written plainly, as far as scripts/count_idioms.py can count that."""

import ast

import pytest

from count_idioms import (
    LIMITS,
    PACKAGE,
    count_idioms,
    find_bare_any,
    find_bundles,
    find_parallel_assignments,
    find_touches,
    find_unpacked_generators,
)

COUNTS = count_idioms(PACKAGE)


@pytest.mark.parametrize("name", LIMITS)
def test_no_idiom_is_over_its_limit(name):
    places = [f"{path.relative_to(PACKAGE)}:{line}" for path, line in COUNTS.idioms[name].lines]
    assert COUNTS.share(name) <= LIMITS[name], "\n".join(places)


def test_the_counts_cover_the_whole_package():
    assert COUNTS.num_lines > 40_000
    assert COUNTS.num_bindings > 25_000


@pytest.mark.parametrize(
    ("finder", "code", "plain"),
    [
        (find_parallel_assignments, "a, b = f(), g()", "a, b = b, a"),
        (find_parallel_assignments, "a, b = 0, 1", "a, b = divmod(7, 2)"),
        (find_unpacked_generators, "a, b = (f(x) for x in pair)", "a = [f(x) for x in pair]"),
        (find_bundles, "def g():\n    work = 1, 2\n    f(*work)", "def g(work):\n    f(*work)"),
        (find_bundles, "def g():\n    a, work = 0, (1, 2)\n    f(*work)", "def g():\n    f(1, 2)"),
        (find_touches, "_ = stage.value", "_ = stage.value()"),
        (find_bare_any, "def g(x: Any): ...", "def g(x: list[Any]): ..."),
        (find_bare_any, "def g() -> Any: ...", "def g() -> int: ..."),
    ],
)
def test_each_idiom_is_found_where_it_is(finder, code, plain):
    assert len(list(finder(ast.parse(code)))) == 1
    assert list(finder(ast.parse(plain))) == []


def test_a_vague_name_is_counted(tmp_path):
    (tmp_path / "module.py").write_text("def count(own, cells):\n    found = own\n")
    counts = count_idioms(tmp_path)
    assert len(counts.idioms["vague names"].lines) == 2
    assert counts.num_bindings == 4
