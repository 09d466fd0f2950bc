"""The command `navbake warm-up`, and what is said where it wasn't run."""

from __future__ import annotations

import sys


def warm_up() -> None:
    """Compile everything for this machine, once; takes a minute or two."""
    from navbake.cli.compile_all import warm_up as compile_all
    from navbake.cli.tables import StageProgress

    with StageProgress(title="compiling") as progress:
        compile_all(progress)
    print("compiled; what follows starts at once")


def tell_if_cold() -> None:
    """Say on a terminal that the first bake waits for the compiler."""
    from navbake.cli.compile_all import is_warm

    if sys.stderr.isatty() and not is_warm():
        print("navbake: compiling for this machine, once: about a minute", file=sys.stderr)
