#!/usr/bin/env bash
# What runs each night.
#
#   bash scripts/nightly.sh fuzz SEED    # mutated inputs of all readers
#   bash scripts/nightly.sh mujoco       # the tests that meet MuJoCo, with its newest version
#   bash scripts/nightly.sh bench        # all rows of the benchmark; status 1 where one is missed
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
use_venv test
case ${1:-} in
    fuzz) python scripts/fuzz.py --count "${COUNT:-5000}" --seed "${2:?a seed}" ;;
    mujoco)
        newest=$(python -m pip index versions mujoco 2>/dev/null | sed -n 's/^mujoco (\(.*\))/\1/p')
        bash scripts/test_versions.sh "$newest"
        ;;
    bench)
        use_venv bench
        python scripts/bench.py --json bench.json
        ;;
    *) echo "$0: expected fuzz SEED, mujoco or bench, got ${1:-nothing}" >&2 && exit 2 ;;
esac
