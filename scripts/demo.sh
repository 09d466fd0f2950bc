#!/usr/bin/env bash
# Bakes an apartment and draws its grid, into demo/ of this checkout.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh"
use_venv plot

mkdir -p demo
navbake bake configs/apartment.yaml -o demo/apartment.grid.json
navbake plot demo/apartment.grid.json -o demo/apartment.png >/dev/null
echo "grid:    $PWD/demo/apartment.grid.json"
echo "picture: $PWD/demo/apartment.png"
