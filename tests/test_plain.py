"""The package is written plainly, as far as scripts/count_idioms.py can count that.

What docstrings list as parameters and fields is what the code has, and the places that they and
comments refer to exist.
"""

import ast
import importlib
import re
from collections.abc import Iterator

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


@pytest.fixture(scope="module")
def package_counts():
    return count_idioms(PACKAGE)


@pytest.mark.parametrize("name", LIMITS)
def test_no_idiom_is_over_its_limit(package_counts, name):
    lines = package_counts.idioms[name].lines
    places = [f"{path.relative_to(PACKAGE)}:{line}" for path, line in lines]
    assert package_counts.share(name) <= LIMITS[name], "\n".join(places)


def test_the_counts_cover_the_whole_package(package_counts):
    assert package_counts.num_lines > 40_000
    assert package_counts.num_bindings > 25_000


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


def list_entries(docstring: str, section: str) -> list[str]:
    """Return the names that a section of a Google docstring lists, without stars."""
    match = re.search(rf"^{section}:\n((?: .*\n|\n)+)", docstring + "\n", re.MULTILINE)
    text = "" if match is None else match[1]
    entries = re.findall(r"^ {4}([\w*][\w*, ]*):", text, re.MULTILINE)
    return [name for names in entries for name in re.findall(r"\w+", names)]


def list_parameters(function: ast.FunctionDef) -> list[str]:
    """Return the names of a function's parameters, without ``self`` and ``cls``."""
    arguments = function.args
    parameters = [*arguments.posonlyargs, *arguments.args, arguments.vararg]
    parameters += [*arguments.kwonlyargs, arguments.kwarg]
    names = [parameter.arg for parameter in parameters if parameter is not None]
    return [name for name in names if name not in ("self", "cls")]


def list_fields(definition: ast.ClassDef) -> list[str]:
    """Return the names of the annotated fields of a class."""
    return [
        statement.target.id
        for statement in definition.body
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)
    ]


def has_fixed_fields(definition: ast.ClassDef) -> bool:
    """Return whether a class is a NamedTuple or a dataclass."""
    makers = " ".join(map(ast.unparse, [*definition.bases, *definition.decorator_list]))
    return re.search(r"\b(NamedTuple|dataclass)\b", makers) is not None


def find_wrong_entries(tree: ast.Module) -> Iterator[str]:
    """Describe the docstrings whose ``Args`` or ``Attributes`` contradict the code."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef | ast.ClassDef):
            continue
        docstring = ast.get_docstring(node) or ""
        listed_parameters = list_entries(docstring, "Args")
        if isinstance(node, ast.FunctionDef):
            parameters = list_parameters(node)
        else:
            makers = [
                statement
                for statement in node.body
                if isinstance(statement, ast.FunctionDef) and statement.name == "__init__"
            ]
            parameters = list_parameters(makers[0]) if makers else list_fields(node)
            listed_fields = set(list_entries(docstring, "Attributes"))
            unknown_fields = sorted(listed_fields - set(list_fields(node)))
            if unknown_fields and has_fixed_fields(node):
                yield f"{node.name}: no fields {', '.join(unknown_fields)}"
        if listed_parameters and listed_parameters != parameters:
            listed_text = ", ".join(listed_parameters)
            yield f"{node.name}({', '.join(parameters)}): the docstring has {listed_text}"


def test_docstrings_list_the_parameters_and_fields_that_there_are():
    wrong_entries = [
        f"{path.relative_to(PACKAGE)}: {text}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for text in find_wrong_entries(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert not wrong_entries, "\n".join(wrong_entries)


@pytest.mark.parametrize(
    ("code", "is_right"),
    [
        ('def f(a, *, b): """F.\n\n    Args:\n        a: A.\n        b: B: b."""', True),
        ('def f(a, b, c): """F.\n\n    Args:\n        a, b: A and B.\n        c: C."""', True),
        ('def f(a, b): """F.\n\n    Args:\n        a: A."""', False),
        ('def f(a, b): """F.\n\n    Args:\n        b: B.\n        a: A."""', False),
        (
            'def f(a): """F.\n\n    Args:\n        a: A,\n            so: that.\n        b: B."""',
            False,
        ),
        ('def f(*a, **b): """F.\n\n    Args:\n        *a: A.\n        b: B."""', True),
        (
            'class C:\n    """C.\n\n    Args:\n        a: A.\n    """\n    def __init__(self): ...',
            False,
        ),
        (
            'class C(NamedTuple):\n    """C.\n\n    Attributes:\n        a: A."""\n    b: int',
            False,
        ),
        (
            '@dataclass\nclass C:\n    """C.\n\n    Attributes:\n        b: B."""\n    b: int',
            True,
        ),
    ],
)
def test_a_wrong_entry_of_a_docstring_is_found(code, is_right):
    assert (list(find_wrong_entries(ast.parse(code))) == []) == is_right


def exists(dotted_name):
    """Whether a module, or a name in it, can be found, such as ``navbake.files.write_file``."""
    parts = dotted_name.split(".")
    for num_modules in range(len(parts), 0, -1):
        try:
            owner = importlib.import_module(".".join(parts[:num_modules]))
        except ImportError:
            continue
        for name in parts[num_modules:]:
            if name in getattr(owner, "__annotations__", {}):  # a field: it has no attributes here
                return True
            if not hasattr(owner, name):
                return False
            owner = getattr(owner, name)
        return True
    return False


def test_places_that_are_referred_to_exist():
    # two parts may be a key of a grid's metadata, such as `navbake.links`
    reference = re.compile(r"`(navbake(?:\.\w+){2,})`")
    missing = [
        f"{path.relative_to(PACKAGE)}: {dotted_name}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for dotted_name in sorted(set(reference.findall(path.read_text(encoding="utf-8"))))
        if not exists(dotted_name)
    ]
    assert not missing, "\n".join(missing)
    assert exists("navbake.runtime.flat_grid.FlatGrid.slope_bits")
    assert not exists("navbake.runtime.blocking.fit_grid")
