#!/usr/bin/env bash
# Exports a scene to every format and lets the tools of others read the files.
#
#   tools/third-party/check.sh SCENE [REPORT.md]
#
# SCENE is the folder of a run or a scene file. Needs python3 (3.10 or later), npm, and the program:
# MINUTE4D (default: target/release/minute4d). The tools are installed by name and version from PyPI and
# npm into MINUTE4D_THIRD_PARTY, or into a temporary folder that is removed. The exit code is 0 only if
# every tool accepts every file and finds in it what the scene holds.
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
scene=${1:?usage: tools/third-party/check.sh SCENE [REPORT.md]}
report=${2:-/dev/stdout}
program=${MINUTE4D:-$here/../../target/release/minute4d}
[ -x "$program" ] || { echo "there is no $program: build it (cargo build --release) or set MINUTE4D" >&2; exit 66; }

if [ -n "${MINUTE4D_THIRD_PARTY:-}" ]; then
    work=$MINUTE4D_THIRD_PARTY
    mkdir -p "$work"
else
    work=$(mktemp -d)
    trap 'rm -rf "$work"' EXIT
fi

if [ ! -e "$work/installed" ]; then
    python3 -m venv "$work/python"
    "$work/python/bin/pip" install --quiet --disable-pip-version-check -r "$here/requirements.txt"
    cp "$here/package.json" "$work/"
    # scripts of packages are not run: nothing here needs one
    (cd "$work" && npm install --silent --no-fund --no-audit --ignore-scripts --force >&2)
    touch "$work/installed"
fi

cp "$here"/*.mjs "$work/"
rm -rf "$work/files"
"$work/python/bin/python" "$here/check.py" \
    --scene "$scene" --program "$program" --tools "$work" --files "$work/files" --report "$report"
