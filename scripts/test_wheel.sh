#!/usr/bin/env bash
# Builds the wheel and the source distribution into dist/, checks both, and runs the README's commands
# from the wheel in empty environments.
#
#   bash scripts/test_wheel.sh                        # with this machine's python3
#   bash scripts/test_wheel.sh python3.10 python3.13  # with several
#   bash scripts/test_wheel.sh --lowest               # with the oldest version of each dependency
#   bash scripts/test_wheel.sh --tag v0.3.0           # for a release: the tag is the version
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

lowest= tag= pythons=()
while (($#)); do
    case $1 in
        --lowest) lowest=yes ;;
        --tag) tag=$2 && shift ;;
        *) pythons+=("$1") ;;
    esac
    shift
done
[ ${#pythons[@]} -gt 0 ] || pythons=("${PYTHON:-python3}")
unset PYTHONDONTWRITEBYTECODE
export PIP_DISABLE_PIP_VERSION_CHECK=1

tools=.venv-release
if [ ! -x $tools/bin/uv ]; then
    "${pythons[0]}" -m venv $tools
    $tools/bin/python -m pip install --quiet build twine check-wheel-contents uv
fi
version=$(sed -n 's/^__version__ = "\(.*\)"/\1/p' navbake/_version.py)
for place in "CITATION.cff:^version: $version$" "CHANGELOG.md:^## \[$version\]" "recipe/recipe.yaml:^  version: \"$version\"$"; do
    grep -q "${place#*:}" "${place%%:*}" || { echo "$0: ${place%%:*} doesn't name $version" >&2; exit 1; }
done
if [ -n "$tag" ] && [ "$tag" != "v$version" ]; then
    echo "$0: expected the tag v$version, got $tag" >&2
    exit 1
fi

rm -rf dist
$tools/bin/python -m build >/dev/null
$tools/bin/twine check --strict dist/*
$tools/bin/check-wheel-contents dist/*.whl

checkout=$PWD
wheel=$(ls "$checkout"/dist/*.whl)
for python in "${pythons[@]}"; do
    place=$(mktemp -d)
    "$python" -m venv "$place/venv"
    "$place/venv/bin/python" -m pip install --quiet --upgrade pip # that of 3.10 tries versions for minutes
    if [ -n "$lowest" ]; then
        # matplotlib is for the README's pictures
        $tools/bin/uv pip compile --quiet --no-header --extra plot --resolution lowest-direct \
            --python "$place/venv/bin/python" pyproject.toml -o "$place/lowest.txt"
        "$place/venv/bin/python" -m pip install --quiet -r "$place/lowest.txt" "$wheel[plot]"
    else
        "$place/venv/bin/python" -m pip install --quiet "$wheel"
        count=$("$place/venv/bin/python" -m pip list --format freeze | grep -vc '^pip==\|^setuptools==')
        size=$(du -sm "$place/venv/lib" | cut -f1)
        "$place/venv/bin/python" -m pip install --quiet "$wheel[plot]"
    fi
    "$place/venv/bin/python" -m pip check
    mkdir "$place/work"
    # in a folder of its own, so that nothing of the checkout is found
    "$place/venv/bin/python" scripts/run_readme.py "$place/venv/bin" "$place/work"
    echo "$python ($("$place/venv/bin/python" -V)): ${lowest:+lowest versions, }README's commands run${count:+; $count packages, $size MB without [plot]}"
    rm -rf "$place"
done
