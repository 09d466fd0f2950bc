"""Bake the sample scenes into the golden files of the tests. Look at the change before you keep it.

python scripts/make_golden.py            # all of configs/*.yaml
python scripts/make_golden.py house      # some
"""

from __future__ import annotations

import argparse
from pathlib import Path

from navbake.baker.bake.pipeline import run_bake
from navbake.config.settings import load_config

ROOT = Path(__file__).resolve().parents[1]
GOLDEN = ROOT / "tests" / "golden"


def make_golden(name: str) -> Path:
    """Bake one sample and write its golden file, without timings.

    Args:
        name: the stem of a file in ``configs/``.

    Returns:
        Where it is.
    """
    grid = run_bake(load_config(ROOT / "configs" / f"{name}.yaml")).grid
    grid.timings = {}
    path = GOLDEN / f"{name}.grid.json.gz"
    path.parent.mkdir(exist_ok=True)
    grid.save(path)
    return path


def main() -> None:
    """Write the golden files asked for."""
    samples = sorted(path.stem for path in (ROOT / "configs").glob("*.yaml"))
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("names", nargs="*", help=f"some of {', '.join(samples)}; default all")
    names = parser.parse_args().names or samples
    unknown = [name for name in names if name not in samples]
    if unknown:
        parser.error(f"no sample {', '.join(unknown)}: expected some of {', '.join(samples)}")
    for name in names:
        print(make_golden(name).relative_to(ROOT))


if __name__ == "__main__":
    main()
