# SPDX-License-Identifier: Apache-2.0
# Virtual environments for the scripts; sourced by them, not run. Bash.
#
#   make_environment FOLDER CONSTRAINTS EXTRAS [VERSION...]
#
# makes or updates a virtual environment in FOLDER with this package, installed editable with the optional
# dependencies EXTRAS ("" or "ros,test") at the versions pinned in CONSTRAINTS, on the first of the Python VERSIONs
# (default: 3.12 3.11 3.13 3.14) that this machine has. Does nothing when FOLDER is up to date. Afterwards $PYTHON runs it.

ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

# A sourced ROS workspace would put its own modules, libraries and middleware before those of the environment.
unset PYTHONPATH PYTHONHOME AMENT_PREFIX_PATH COLCON_PREFIX_PATH RMW_IMPLEMENTATION
if [[ ${LD_LIBRARY_PATH:-} == */ros/* ]]; then unset LD_LIBRARY_PATH; fi
export PIP_USER=0 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_INPUT=1

# The two parts of the suite, as arguments of pytest: two files at a time; and what is live, with the machine for itself.
OFFLINE=(-n 2 --dist loadfile --ignore test/ros)
LIVE=(test/ros)

fail() {
    echo "${0##*/}: error: $*" >&2
    exit 1
}

make_environment() {
    local folder=$1 constraints=$ROOT/$2 extras=$3
    shift 3
    PYTHON=$folder/bin/python
    # The key of an environment with more extras serves those that need fewer.
    local key wanted have
    key=$(_installed_files "$constraints" | sort | xargs -d '\n' cat | sha256sum | cut -d' ' -f1)
    wanted="$key $folder"
    if _is_ready "$folder" "$wanted" "$extras"; then return; fi

    [[ ! -e $folder || -e $folder/made-by-scripts ]] ||
        fail "$folder: exists and was not made by this script; need another place (set IMGU_VENV) or that folder moved away"
    mkdir -p "$folder"
    # Two scripts started at once take turns.
    if command -v flock >/dev/null; then
        exec 9>"$folder.lock"
        flock 9
        if _is_ready "$folder" "$wanted" "$extras"; then exec 9>&-; return; fi
    fi

    # Without a finished installation in this very place start afresh: an interrupted pip leaves half packages behind.
    have=$(cat "$folder/installed" 2>/dev/null || true)
    if [[ $have != *" $folder "* ]] || ! "$PYTHON" -m pip --version >/dev/null 2>&1; then
        _find_python "$@"
        echo "${0##*/}: making ${folder/#$ROOT\//} with Python $FOUND_VERSION" >&2
        rm -rf "$folder"
        mkdir -p "$folder"
        touch "$folder/made-by-scripts"
        "$FOUND_PYTHON" -m venv "$folder"
    fi
    rm -f "$folder/installed"
    echo "${0##*/}: installing imgu_ros${extras:+ [$extras]} and what it needs (once; a minute or two)" >&2
    # First what builds this package, and the few that publish no wheel.
    install_locked "$constraints" build "imgu_ros${extras:+,$extras}"
    # From what is installed now, or not at all: nothing enters whose digest was not checked.
    _install --no-index --no-build-isolation --editable "$ROOT${extras:+[$extras]}"
    echo "$wanted ,$extras," >"$folder/installed"
    if command -v flock >/dev/null; then exec 9>&-; fi
}

# make_tools FOLDER LOCK NAME: an environment, with the interpreter of $PYTHON, of the tools that LOCK has for NAME and of
# nothing else. Afterwards $PYTHON runs it.
make_tools() {
    local folder=$1 lock=$ROOT/$2 python=$PYTHON key
    key="$python $(sha256sum <"$lock")"
    PYTHON=$folder/bin/python
    if [[ $(cat "$folder/installed" 2>/dev/null) == "$key" ]]; then return; fi
    echo "${0##*/}: making ${folder/#$ROOT\//} (once)" >&2
    rm -rf "$folder"
    "$python" -m venv "$folder"
    install_locked "$lock" "$3"
    echo "$key" >"$folder/installed"
}

# install_locked LOCK NAMES...: install into the environment of $PYTHON what NAMES need ("imgu_ros,ros"), exactly as
# locked; a file with another digest is refused.
install_locked() {
    local lock=$1 names needed status=0
    shift
    needed=$(mktemp)
    for names in "$@"; do
        "$PYTHON" "$ROOT/scripts/lock.py" "$lock" "$names" >"$needed" &&
            _install --require-hashes --no-deps --no-build-isolation --requirement "$needed" || status=$?
        [[ $status -eq 0 ]] || break
    done
    rm -f "$needed"
    return "$status"
}

# Python compiles what it imports; to compile everything would take as long as all the rest.
_install() {
    "$PYTHON" -m pip install --quiet --no-compile "$@"
}

# The optional dependencies that exist for this machine: rclpy comes as wheels for x86-64 Linux alone.
available_extras() {
    if [[ $(uname -sm) == "Linux x86_64" ]]; then
        echo "$1"
    else
        echo "${0##*/}: no ROS wheels for $(uname -sm): the tests that need rclpy will be skipped" >&2
        sed -E 's/(^|,)ros(,|$)/\1/; s/,$//' <<<"$1"
    fi
}

# What is copied or acted upon at installation; the modules themselves are used from where they are.
_installed_files() {
    printf '%s\n' "$1" "$ROOT"/{setup.py,setup.cfg,package.xml,scripts/environment.sh,scripts/lock.py}
    find "$ROOT/config" "$ROOT/launch" -type f ! -name '*.pyc' 2>/dev/null || true
}

_is_ready() {
    local folder=$1 wanted=$2 extra stamp
    stamp=$(cat "$folder/installed" 2>/dev/null) || return 1
    [[ $stamp == "$wanted ,"* && -x $folder/bin/python ]] || return 1
    for extra in ${3//,/ }; do
        [[ $stamp == *",$extra,"* ]] || return 1
    done
}

# Sets FOUND_PYTHON and FOUND_VERSION to the first usable interpreter of the given versions.
_find_python() {
    local version candidate broken=""
    if [[ -n ${IMGU_PYTHON:-} ]]; then
        _try_python "$IMGU_PYTHON" && return
        fail "IMGU_PYTHON=$IMGU_PYTHON: does not run or has no venv module; need Python 3.11 to 3.14"
    fi
    [[ $# -gt 0 ]] || set -- 3.12 3.11 3.13 3.14
    for version in "$@"; do
        # A shim of pyenv can be on PATH for a version that is not switched on: trying it is the only way to know.
        for candidate in "python$version" python3 "${PYENV_ROOT:-${HOME:-}/.pyenv}/versions/$version".*/bin/python; do
            command -v "$candidate" >/dev/null || continue
            [[ $("$candidate" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) == "$version" ]] || continue
            if _try_python "$candidate"; then return; fi
            broken=$version
        done
    done
    if [[ -n $broken ]]; then
        fail "Python $broken has no venv module; need: sudo apt install python$broken-venv"
    fi
    fail "no Python$(printf ' or %s' "$@" | cut -c4-) found on PATH; need: sudo apt install python3 python3-venv (or set IMGU_PYTHON to an interpreter)"
}

_try_python() {
    "$1" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12), (3, 13), (3, 14)))' 2>/dev/null || return 1
    FOUND_PYTHON=$1
    FOUND_VERSION=$("$1" -c 'import platform; print(platform.python_version())')
}
