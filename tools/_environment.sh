# The project's own Python environment, .venv: made at first use, brought up to date when pyproject.toml changes.
# Sourced by the other scripts of this folder.
#
#   prepare_environment run    what `lfmesh` needs
#   prepare_environment dev    that and what the tests and checks need
#   prepare_environment docs   that and what builds the documentation site
#   prepare_environment long   that and the programs that long tests compare with
#
# LFMESH_PYTHON names another Python, which gets an environment of its own beside .venv, such as .venv-python3.13.
#
# Afterwards $root is the project's folder and $environment that of its environment. Everything said here goes to
# stderr, so that the output of a command can be redirected.
#
# Nothing is ever installed into the environment of another folder. A link to one is refused; a copy, which came with
# the folder, is made anew.

root=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
environment=$root/.venv${LFMESH_PYTHON:+-${LFMESH_PYTHON##*/}}

# Says which pyproject.toml was installed for which folder and purpose. It is removed before an installation and
# written after it, so an interrupted one is done again.
stamp=$environment/lfmesh-installed

# Each of these would send an installation elsewhere.
unset PYTHONHOME PIP_PREFIX PIP_PYTHON PIP_ROOT PIP_TARGET PIP_USER

say() {
    printf 'lfmesh: %s\n' "$*" >&2
}

# Prints the Python that LFMESH_PYTHON names, or else the newest one that serves. A shim of a version manager may be on
# the PATH and still not run.
find_python() {
    local candidate found=''
    set -- python3.13 python3.12 python3.11 python3
    [ -z "${LFMESH_PYTHON-}" ] || set -- "$LFMESH_PYTHON"
    for candidate in "$@"; do
        "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null </dev/null || continue
        found=$candidate
        if "$candidate" -c 'import ensurepip, venv' 2>/dev/null </dev/null; then
            command -v "$candidate"
            return
        fi
    done
    if [ -n "$found" ]; then
        say "$found cannot make virtual environments: install its venv module (Debian: apt-get install $found-venv)."
    else
        say "needs Python 3.11 or newer; looked for $*."
    fi
    return 1
}

# Prints 1, 2, 3 or 4 for the purposes run, dev, docs and long: each holds what the one before holds.
rank() {
    case $1 in
        long) echo 4 ;;
        docs) echo 3 ;;
        dev) echo 2 ;;
        *) echo 1 ;;
    esac
}

# Off-screen drawing needs two system libraries, for `dev` the tests of the page in a browser need Chromium, and for
# `long` gmsh needs libraries of the window system; everything else works without them.
install_system_packages() {
    [ "$(uname -s)" = Linux ] || return 0
    local wanted='libegl1 libgl1-mesa-dri' missing=''
    [ "$1" = run ] || wanted="$wanted chromium"
    [ "$1" != long ] || wanted="$wanted libglu1-mesa libxcursor1 libxft2 libxinerama1"
    if command -v dpkg-query >/dev/null && command -v apt-get >/dev/null; then
        local package
        for package in $wanted; do
            case $(dpkg-query -W -f='${Status}' "$package" 2>/dev/null || true) in
                *' installed') ;;
                *) missing="$missing $package" ;;
            esac
        done
    else
        if ! ldconfig -p 2>/dev/null | grep 'libEGL\.so\.1' >/dev/null; then
            say "drawing needs the EGL and Mesa DRI libraries (Debian: libegl1 libgl1-mesa-dri): install your system's."
        fi
        if [ "$1" != run ] && ! command -v chromium chromium-browser google-chrome >/dev/null; then
            say "the tests of the page in a browser need Chromium: install your system's."
        fi
        return 0
    fi
    [ -n "$missing" ] || return 0
    if [ "$(id -u)" -ne 0 ]; then
        say "drawing and its tests need system packages; install them with: sudo apt-get install$missing"
        return 0
    fi
    say "installing the system packages$missing"
    # $missing is a list of words on purpose.
    # shellcheck disable=SC2086
    if ! { apt-get -qq update && DEBIAN_FRONTEND=noninteractive \
        apt-get -qq install --yes --no-install-recommends $missing; } </dev/null >/dev/null; then
        say "apt-get could not install$missing; everything but drawing works without."
    fi
}

wanted_stamp() {
    printf '%s\n%s\n' "$root" "$(cksum <"$root/pyproject.toml")"
}

# Whether the installation on disk serves the purpose $1.
up_to_date() {
    [ -x "$environment/bin/python" ] && [ -f "$stamp" ] || return 1
    [ "$(head -n 2 "$stamp")" = "$(wanted_stamp)" ] || return 1
    [ "$(rank "$(tail -n 1 "$stamp")")" -ge "$(rank "$1")" ]
}

# Whether the environment on disk was made for this folder. The stamp says for which one, or else venv's own record,
# "command = PYTHON -m venv OPTIONS FOLDER". A python that leads elsewhere would install there.
made_here() {
    local line folder=''
    if [ -f "$stamp" ]; then
        [ "$(head -n 1 "$stamp")" = "$root" ] || return 1
    elif [ -f "$environment/pyvenv.cfg" ]; then
        while IFS= read -r line || [ -n "$line" ]; do
            case $line in
                'command = '*' -m venv'*' /'*) folder=/${line##* /} ;;
            esac
        done <"$environment/pyvenv.cfg"
        [ -z "$folder" ] || [ "$folder" -ef "$environment" ] || return 1
    fi
    line=$("$environment/bin/python" -c 'import os, sys; print(os.path.realpath(sys.prefix))' 2>/dev/null </dev/null)
    [ "$line" = "$environment" ]
}

install_project() {
    local purpose=$1 installed
    if [ -L "$environment" ]; then
        say "${environment##*/} is a link to $(readlink -- "$environment"), and nothing is installed into an environment"
        say "of another folder. Remove the link, and this folder gets its own, or call that environment's bin/python."
        return 1
    fi
    if [ -f "$stamp" ]; then
        installed=$(tail -n 1 "$stamp")
        [ "$(rank "$installed")" -le "$(rank "$purpose")" ] || purpose=$installed
    fi
    if ! made_here || ! "$environment/bin/python" -m pip --version >/dev/null 2>&1; then
        local python
        python=$(find_python) || return 1
        say "making ${environment##*/} with $python"
        rm -rf -- "$environment"
        "$python" -m venv "$environment" >&2 || return 1
    fi
    rm -f -- "$stamp"
    say "installing lfmesh and what it needs into ${environment##*/}; this takes a minute or two"
    local extras
    case $purpose in
        long) extras='[dev,docs,long]' ;;
        docs) extras='[dev,docs]' ;;
        dev) extras='[dev]' ;;
        *) extras='[browser]' ;;
    esac
    (cd -- "$root" && "$environment/bin/python" -m pip install --quiet --disable-pip-version-check \
        --editable ".$extras") </dev/null >&2 || {
        say "the installation failed; the lines above say why. Run the command again to resume."
        return 1
    }
    { wanted_stamp && printf '%s\n' "$purpose"; } >"$stamp.new" && mv -f -- "$stamp.new" "$stamp"
}

prepare_environment() {
    if up_to_date "$1"; then
        [ "$1" = run ] || install_system_packages "$1"
        return
    fi
    # Two commands started at once must not install over each other: lock the project's folder itself.
    if command -v flock >/dev/null; then
        exec 9<"$root"
        flock --nonblock 9 || {
            say "waiting for another command that is installing"
            flock 9
        }
    fi
    up_to_date "$1" || { install_system_packages "$1" && install_project "$1"; } || exit 1
    exec 9<&-
}
