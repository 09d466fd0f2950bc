#!/usr/bin/env bash
# Everything that must pass: lint, format, types, tests. Arguments go to pytest.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
use_venv test

# what some tests need and not every machine has; these tests are skipped without it
missing=$(python - <<'EOF'
from importlib.util import find_spec
from shutil import which

packages = ("dm_control", "gymnasium_robotics", "habitat", "jax", "labmaze", "matplotlib", "octomap", "ogbench", "torch", "zensical")
missing = [name for name in packages if find_spec(name) is None]
missing += [name for name in ("binvox2bt", "chromedriver") if which(name) is None]
print(", ".join(missing))
EOF
)

ruff check
ruff format --check
check_types() {
    if has_pins; then
        exec mypy
    fi
    echo "$0: no mypy on Python 3.10, whose numpy has other types" >&2
}
# mypy takes one core for long where it has no cache yet, so it runs beside the next step
check_types &
types=$!
trap 'kill "$types" 2>/dev/null || true' EXIT # where the next step fails, mypy doesn't go on alone
navbake warm-up # compiled once, before several processes need it
wait "$types"
trap - EXIT
# the processes share the cores; numpy's matrix products would start threads in each of them
export OPENBLAS_NUM_THREADS=1
# what JAX compiles is kept for the next run: for most of its tests, compiling takes the longest
export JAX_COMPILATION_CACHE_DIR=$PWD/.pytest_cache/jax
export JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0 JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES=-1
# one more than there are cores, at most 4: some tests wait for the processes that they start
processes=$(python -c "import os; print(min((os.cpu_count() or 1) + 1, 4))")
# -rs lists what was skipped, and why; the tests of a file stay in one process, and the files that
# take long come first, see tests/conftest.py: xdist would put those with few tests last
python -m pytest -rs --numprocesses "$processes" --dist loadfile --no-loadscope-reorder "$@"
if [ -n "$missing" ]; then
    echo "$0: skipped the tests that need $missing" >&2
    echo "$0: jax and torch come with: .venv/bin/pip install -e '.[tensors-test]'" >&2
fi
