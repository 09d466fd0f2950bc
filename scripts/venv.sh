# Sourced by the other scripts: a virtual environment in .venv with navbake and one of its extras.
# Leaves the current folder at the checkout, and the environment's programs first in PATH.

has_pins() { # whether constraints.txt has versions for this Python: for 3.11 and newer
    python -c "import sys; sys.exit(sys.version_info < (3, 11))"
}

use_venv() { # use_venv EXTRA
    local extra=$1 python=${PYTHON:-python3} stamp
    unset PYTHONDONTWRITEBYTECODE # without bytecode each command starts three times as slowly
    cd "$(dirname "${BASH_SOURCE[0]}")/.."
    if [ ! -x .venv/bin/python ]; then
        if ! "$python" -c "import venv, ensurepip" 2>/dev/null; then
            echo "$0: $python cannot make virtual environments: install python3-venv," \
                "or set PYTHON to one that can" >&2
            exit 1
        fi
        "$python" -m venv .venv
    fi
    PATH=$PWD/.venv/bin:$PATH
    # installed again only when what is to be installed has changed
    stamp=$(cat pyproject.toml constraints.txt | cksum)
    if [ "$(cat ".venv/installed-$extra" 2>/dev/null)" != "$stamp" ]; then
        echo "$0: installing navbake[$extra] into .venv, about 600 MB:" >&2
        local pins=(--constraint constraints.txt)
        if ! has_pins; then
            pins=() # 3.10 takes the newest that it can have
            # the pip that comes with 3.10 tries versions for ten minutes and more
            python -m pip install --quiet --quiet --disable-pip-version-check --upgrade pip
        fi
        # with bytecode, as pip writes it: else commands in an image that writes none start three
        # times as slowly; a line for each package shows that it goes on
        python -u -m pip install --disable-pip-version-check --progress-bar off \
            --editable ".[$extra]" ${pins[@]+"${pins[@]}"} |
            sed -u -n -e 's/^Collecting \([^ ]*\).*/  \1/p' -e 's/^Installing collected.*/  unpacking/p' >&2
        echo "$stamp" >".venv/installed-$extra"
    fi
}
