#!/usr/bin/env bash
# Makes the documentation's site in build/site; `--publish v0.3.0` commits it to the branch gh-pages,
# after what is published there; `--push` publishes that.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
use_venv docs
# mike still takes mkdocs along, which nothing else needs
if [[ " $* " == *" --publish "* ]]; then pip install --quiet --disable-pip-version-check "mike>=2.2"; fi
python scripts/make_docs.py "$@"
