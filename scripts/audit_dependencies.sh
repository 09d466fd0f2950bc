#!/usr/bin/env bash
# Asks pip-audit for known weaknesses of the versions in constraints.txt. Needs the network: the
# advisories are not in any package. Arguments go to pip-audit: `--vulnerability-service osv`.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# beside the environment of the tests: what audits is not audited
tool=.venv-audit
if [ ! -x "$tool/bin/pip-audit" ]; then
    "${PYTHON:-python3}" -m venv "$tool"
    "$tool/bin/python" -m pip install --quiet --disable-pip-version-check "pip-audit>=2.7"
fi
# --strict: a version that could not be asked about is a failure, not a pass
"$tool/bin/pip-audit" --strict --no-deps --disable-pip --requirement constraints.txt "$@"
