"""Write navbake/kernels.json: which kernels Python calls, with which types, and what they cost.

Bakes a sample and does what `navbake warm-up` does, with nothing compiled beforehand. Takes some
minutes. Run it when a test says that the list is out of date.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]


def main() -> None:
    """Compile all kernels, and list them."""
    argparse.ArgumentParser(description="Write the list of kernels, in some minutes.").parse_args()
    with tempfile.TemporaryDirectory() as folder:
        # before numba is imported; and no other process is to take a part of the work
        os.environ.update(NUMBA_CACHE_DIR=folder, NAVBAKE_COMPILES_BESIDE="1")
        found = record()
        from navbake.kernel_list import write_list

        write_list(found)
        print(f"{len(found.entries)} kernels, {sum(e.seconds for e in found.entries):.0f} s")


def record() -> Any:
    """Use all kernels, and note those that Python calls, in the order of the first calls."""
    import navbake
    from navbake.cli.commands.warm_up import compile_all
    from navbake.dispatch import Kernel
    from navbake.kernel_list import Entry, KernelList, encode

    entries: list[Entry] = []
    tuples: dict[str, list[Any]] = {}
    own, compile_one = threading.local(), Kernel.compile  # some compile on threads beside others

    def compile_and_note(kernel: Kernel, sig: Any) -> Any:
        own.depth, begin = getattr(own, "depth", 0) + 1, time.thread_time()
        try:
            return compile_one(kernel, sig)
        finally:
            own.depth -= 1
            if own.depth == 0:  # a kernel that calls this one compiles it, too
                types = [encode(t, tuples) for t in (sig if isinstance(sig, tuple) else sig.args)]
                seconds = round(time.thread_time() - begin, 2)
                entries.append(Entry(kernel.full_name, seconds, types))

    Kernel.compile = compile_and_note
    try:
        navbake.bake(ROOT / "configs" / "apartment.yaml")
        num_common = len(entries)
        compile_all(lambda name, share: None)
    finally:
        Kernel.compile = compile_one
    return KernelList(entries, tuples, num_common)


if __name__ == "__main__":
    main()
