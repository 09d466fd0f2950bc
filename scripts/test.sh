#!/usr/bin/env bash
# Everything that must pass: lint, format, types, tests. Arguments go to pytest.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
use_venv test

ruff check
ruff format --check
mypy
python -m pytest "$@"
