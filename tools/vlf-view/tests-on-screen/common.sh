# What the tests on a screen share: tools, programs and a small pack. Sourced with the root of the
# repository as the current folder; leaves WORK, the folder for all that is made, and PACK in it.

readonly HERE=tools/vlf-view/tests-on-screen WORK=target/tests-on-screen
readonly VLF=target/release/vlf VIEW=target/release/vlf-view PYTHON=$WORK/python/bin/python
readonly PACK=$WORK/room.vlf
export PYTHONDONTWRITEBYTECODE=1 PIP_DISABLE_PIP_VERSION_CHECK=1

complain() {
    echo "error: $*" >&2
    exit 1
}

# Sees that commands are there; asks apt-get for the packages behind them if it may be asked.
# Arguments: command=package ...
need() {
    local pair missing=()
    for pair in "$@"; do
        command -v "${pair%%=*}" >/dev/null || missing+=("${pair#*=}")
    done
    if [ "${#missing[@]}" -eq 0 ]; then return; fi
    if ! command -v apt-get >/dev/null || [ "$(id -u)" -ne 0 ]; then
        complain "these programs are missing, please install them: ${missing[*]}"
    fi
    echo "missing: ${missing[*]}; asking apt-get for them"
    export DEBIAN_FRONTEND=noninteractive
    if ! apt-get install -y --no-install-recommends "${missing[@]}" >"$WORK/apt.log" 2>&1; then
        { apt-get update && apt-get install -y --no-install-recommends "${missing[@]}"; } \
            >"$WORK/apt.log" 2>&1 || complain "apt-get could not install ${missing[*]}: $WORK/apt.log"
    fi
}

# Python with the packages of requirements.txt, made once.
python_packages() {
    local holds
    command -v python3 >/dev/null || complain "python3 is missing: install Python 3.10 or newer"
    holds="$PWD $(python3 --version) $(cat "$HERE/requirements.txt")"
    if [ "$(cat "$WORK/python/holds" 2>/dev/null)" = "$holds" ]; then return; fi
    rm -rf "$WORK/python"
    python3 -m venv "$WORK/python" || complain "python3 has no venv: install it (python3-venv)"
    "$WORK/python/bin/pip" install --quiet --requirement "$HERE/requirements.txt" ||
        complain "the Python packages of $HERE/requirements.txt could not be had"
    echo "$holds" >"$WORK/python/holds"
}

# The programs, and a mirror box baked in a second or two.
programs_and_pack() {
    cargo build --release -p vlf -p vlf-pack -p vlf-view
    if [ -f "$PACK" ] && [ "$PACK" -nt "$VLF" ]; then return; fi
    rm -rf "$WORK"/room.*
    "$VLF" scene cornell_mirror -o "$WORK/room.obj" >/dev/null
    "$VLF" bake "$WORK/room.obj" -o "$WORK/room.field" --quality draft --directions 129 \
        --resolution 32 --cycles 3 >"$WORK/bake.log" 2>&1 || complain "the bake failed: $WORK/bake.log"
    target/release/vlf-pack "$WORK/room.field" -o "$PACK" >"$WORK/pack.log" 2>&1 ||
        complain "the packing failed: $WORK/pack.log"
}
