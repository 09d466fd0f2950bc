#!/usr/bin/env bash
# Tests with other versions of MuJoCo what depends on it: loading, samples, baking from memory.
#
#   bash scripts/test_versions.sh         # the oldest that pyproject.toml allows
#   bash scripts/test_versions.sh 3.11.0 3.17.0
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
use_venv test

oldest=$(sed -n 's/^ *"mujoco>=\([0-9.]*\).*/\1/p' pyproject.toml)
for version in "${@:-$oldest}"; do
    # beside the environment's own, which stays as it is; Python finds this one first
    folder=.venv/mujoco-$version
    if [ ! -d "$folder" ]; then
        pip install --quiet --disable-pip-version-check --no-deps --target "$folder.new" \
            "mujoco==$version"
        mv "$folder.new" "$folder"
    fi
    export PYTHONPATH=$PWD/$folder
    python -c "import mujoco; print('MuJoCo', mujoco.__version__)"
    python -m pytest tests/baker/bake/test_memory.py tests/baker/scene tests/test_golden.py \
        tests/verifier/test_samples.py tests/baker/voxels/test_voxelizer.py
done
