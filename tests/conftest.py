"""What all tests share: `oracles` can be imported, and Hypothesis has no deadlines.

Warnings of numpy's are errors in the tests of readers: a file's numbers are checked before they are
computed with.

Python's garbage collector is off while tests are collected: again and again it would search all
modules and tests, which takes twice as long as all else. They live until the end, so they are
frozen then: the collector leaves them out for good. While tests run it looks for garbage less often
than by Python's default, after so many more new objects, which is half of its time.

How long an example takes says something of the machine, not of the code. `.ci/run` chooses
Hypothesis's own profile `ci`, which has none either.
"""

import gc
import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))

settings.register_profile("navbake", deadline=None)
settings.load_profile("navbake")

# A shell's background jobs ignore Ctrl-C, and so would the commands that tests start and interrupt
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

GARBAGE_THRESHOLD = 5_000  # so many new objects without an end; Python's default is 700

READER_FOLDERS = ("formats", "baker/readers", "voxels", "episodes")

# The files that take longest, each of which stays in one process: where tests run in several, these
# come first, so that no process waits in the end for one that began with such a file late.
LONG_FILES = (
    "batch/test_cluster.py",
    "test_terminal.py",
    "batch/test_run.py",
    "test_compiled.py",
    "tensors/test_tensors.py",
    "cli/test_batch.py",
    "test_docs.py",
    "views/test_plot.py",
    "views/viewer/test_page.py",
    "baker/bake/test_ground_truth.py",
    "verifier/test_samples.py",
    "test_starts.py",
    "views/test_page.py",
    "test_imports.py",
    "test_docs_site.py",
    "test_examples.py",
    "test_buildings.py",
    "baker/scene/test_isolated.py",
    "verifier/test_odd_meshes.py",
    "baker/bake/test_memory.py",
    "runtime/test_stand.py",
    "test_scripts.py",
    "tensors/test_frameworks.py",
    "baker/voxels/test_ground_truth.py",
    "batch/test_workers.py",
    "baker/bake/test_invariance.py",
)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(GARBAGE_THRESHOLD, 10, 10)
        gc.enable()


def pytest_collection_modifyitems(config, items):
    if hasattr(config, "workerinput"):  # one of several processes
        rank_of_file = {Path(__file__).parent / name: rank for rank, name in enumerate(LONG_FILES)}
        items.sort(key=lambda item: rank_of_file.get(item.path, len(LONG_FILES)))
    # as text, asked once for each of ten thousand tests
    folders = tuple(f"{Path(__file__).parent / name}{os.sep}" for name in READER_FOLDERS)
    mark = pytest.mark.filterwarnings("error::RuntimeWarning")
    for item in items:
        if str(item.path).startswith(folders):
            item.add_marker(mark)
