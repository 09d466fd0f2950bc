"""Feeds a reader with inputs that Atheris finds by what they reach in the code; as long as asked.

It begins with inputs of `scripts/fuzz.py`, changes their bytes or asks that for new ones, and goes
on with those that reach new lines. What goes wrong is judged as there. A finding is printed and
kept, once for each place in the code, and the search goes on; what kills the process is kept by
libFuzzer. It needs `pip install atheris` (Linux).

    python scripts/fuzz_atheris.py yaml --seconds 600
    python scripts/fuzz_atheris.py navgrid --folder /tmp/found   # until Ctrl-C
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from random import Random

try:
    import atheris
except ImportError:
    atheris = None  # told when a search is asked for

PACKAGE = Path(__file__).resolve().parents[1] / "navbake"
# numba compiles these from their bytecode, which instruments change
KERNELS = [
    ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts)
    for file in PACKAGE.rglob("kernels/*.py")
]

with atheris.instrument_imports(["navbake"], KERNELS) if atheris else nullcontext():
    import fuzz
    from fuzzing.kind import Input
    from fuzzing.kinds import KINDS

SEEDS = 300  # inputs to begin with
LONGEST = 100_000  # of an input [bytes]
FRESH = 0.1  # of the inputs are made by the kind, the others by changing bytes


def main() -> None:
    """Search one kind of inputs; libFuzzer ends the process."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=sorted(KINDS))
    parser.add_argument("--seconds", type=int, default=0, help="0 for no end")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="keeps what reaches more, and findings")
    given = parser.parse_args()
    if atheris is None:
        parser.exit(1, "fuzz_atheris.py needs Atheris: pip install atheris (Linux only)\n")
    with tempfile.TemporaryDirectory() as name:
        folder = given.folder or Path(name)
        search = Search(given.kind, folder)
        options = [
            *(f"-max_total_time={given.seconds}", f"-seed={given.seed}", f"-max_len={LONGEST}"),
            *(f"-artifact_prefix={folder}/", "-print_final_stats=1", "-rss_limit_mb=0"),
        ]
        atheris.Setup(
            [sys.argv[0], *options, str(search.corpus)], search.use, custom_mutator=search.mutate
        )
        atheris.Fuzz()


class Search:
    """Inputs of a kind, whose first byte says which ending the file's name has."""

    def __init__(self, kind: str, folder: Path) -> None:
        self._kind, self._folder = kind, folder
        self.corpus, self._place = folder / "corpus", folder / "place"
        for each in (self.corpus, self._place):
            each.mkdir(parents=True, exist_ok=True)
        made = [fuzz.make_input(kind, 0, number) for number in range(SEEDS)]
        self._suffixes = sorted({one.suffix for one in made})
        self._beside = made[0].beside
        self._found: set[str] = set()
        for number, one in enumerate(made):
            (self.corpus / f"made-{number}").write_bytes(self._pack(one)[:LONGEST])

    def _pack(self, made: Input) -> bytes:
        known = made.suffix in self._suffixes
        return bytes([self._suffixes.index(made.suffix) if known else 0]) + made.data

    def use(self, data: bytes) -> None:
        """Use one input, and keep it if it is a finding of a new kind."""
        suffix = self._suffixes[data[0] % len(self._suffixes)] if data else self._suffixes[0]
        what = fuzz.use_input(self._kind, Input(data[1:], suffix, self._beside), self._place)
        # numbers and names differ from one to the next, the place in the code doesn't
        lines = [line for line in what.splitlines() if line.startswith("  File")] or [what[:6]]
        if what in fuzz.FINE or lines[-1] in self._found:
            return
        self._found.add(lines[-1])
        path = self._folder / f"found-{self._kind}-{len(self._found)}{suffix}"
        path.write_bytes(data[1:])
        print(f"--- {path}\n{what.rstrip()}", flush=True)

    def mutate(self, data: bytes, max_size: int, seed: int) -> bytes:
        """Another input: one that knows the format, or the same with other bytes."""
        rng = Random(seed)
        if rng.random() < FRESH:
            return self._pack(KINDS[self._kind].make(rng))[:max_size]
        change: Callable[[bytes, int], bytes] = atheris.Mutate
        return change(data, max_size)


if __name__ == "__main__":
    main()
