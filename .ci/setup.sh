#!/bin/sh
# Makes .venv ready: setup.sh (to render) or setup.sh dev (to test as well).
# Installs only what is missing, with apt-get and, where one is not root, sudo. Does nothing when all is there.
set -eu
cd "$(dirname "$0")/.."
extra="${1:-}"
stamp=".venv/.ready${extra:+-$extra}"

say() { echo "setup: $*"; }

apt_install() {  # apt_install WHY PACKAGE...
    why="$1"
    shift
    if ! command -v apt-get >/dev/null 2>&1; then
        say "$why: please install what Debian calls: $*" >&2
        return 1
    fi
    sudo=""
    if [ "$(id -u)" -ne 0 ]; then
        if ! command -v sudo >/dev/null 2>&1; then
            say "$why: please run, as root: apt-get install -y $*" >&2
            return 1
        fi
        sudo="sudo"
    fi
    say "$why: apt-get install $*"
    log="$(mktemp)"
    # Old or absent package lists are the usual reason to fail: they are fetched then, not each time.
    if apt_get install "$@" >"$log" 2>&1 || { apt_get update && apt_get install "$@"; } >"$log" 2>&1; then
        rm -f "$log"
    else
        cat "$log" >&2
        rm -f "$log"
        return 1
    fi
}

apt_get() {  # never asks, waits for another apt-get to end
    verb="$1"
    shift
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=300 "$verb" -y --no-install-recommends \
        "$@" </dev/null
}

find_python() {
    for name in ${PYTHON:-} python3 python3.14 python3.13 python3.12 python3.11; do
        if "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then
            command -v "$name"
            return 0
        fi
    done
    return 1
}

opengl_works() { .venv/bin/python -c 'from glhybrid.context import open_context; open_context()' >/dev/null 2>&1; }

if ! [ -x .venv/bin/python ]; then
    if ! python="$(find_python)"; then
        apt_install "no Python >= 3.11" python3 python3-venv || true
        python="$(find_python)" || { say "Python >= 3.11 is needed; PYTHON=... chooses one" >&2; exit 1; }
    fi
    if ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
        version="$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')"
        apt_install "this Python cannot make environments" "python$version-venv"
    fi
    say "making .venv with $("$python" --version)"
    "$python" -m venv .venv
fi

# Ready if this checkout was installed since pyproject.toml last changed.
if ! [ -f "$stamp" ] || [ pyproject.toml -nt "$stamp" ] || ! [ -x .venv/bin/glhybrid ]; then
    say "installing Python packages into .venv"
    .venv/bin/python -m pip install --quiet --disable-pip-version-check --editable ".${extra:+[$extra]}"
    fresh=1
fi

# Kernels compile at a first run; that belongs here, so that the first model has the best tree too.
[ -z "${fresh:-}" ] || .venv/bin/python -c 'from glhybrid import kernels; kernels.load_all()'

if ! opengl_works; then
    apt_install "no OpenGL driver works yet, Mesa renders in software" libegl1 libegl-mesa0 libgl1-mesa-dri || true
    opengl_works || { .venv/bin/glhybrid doctor >&2; exit 3; }
fi

# Mitsuba, in the image tests, is linked with libatomic and compiles with LLVM >= 17; without them its tests are skipped.
has_library() { ldconfig -p 2>/dev/null | grep -Eq "$1"; }
if [ "$extra" = dev ] && [ -n "${fresh:-}" ]; then
    wanted=""
    has_library 'libatomic\.so\.1' || wanted="libatomic1"
    has_library 'libLLVM[-.](so\.)?(1[7-9]|[2-9][0-9])' || wanted="$wanted libllvm19"
    # shellcheck disable=SC2086 # a list of packages
    [ -z "$wanted" ] || apt_install "Mitsuba needs libraries" $wanted || say "tests against Mitsuba are skipped" >&2
fi

# The viewer's tests want a display, a window manager, somebody who types, and a browser; without them they are skipped.
if [ "$extra" = dev ] && [ -n "${fresh:-}" ]; then
    wanted=""
    for pair in Xvfb:xvfb xdotool:xdotool openbox:openbox chromium:chromium; do
        command -v "${pair%%:*}" >/dev/null 2>&1 || wanted="$wanted ${pair#*:}"
    done
    # shellcheck disable=SC2086 # a list of packages
    [ -z "$wanted" ] || apt_install "tests of the viewer" $wanted || say "tests of the viewer's window are skipped" >&2
fi

touch "$stamp"
[ -z "${fresh:-}" ] || say "ready"
