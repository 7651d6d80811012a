#!/usr/bin/env bash
# Checks the files of networks that are here, end to end: every file of weights, then the front end on a clip.
#
#   tools/models/check.sh                      # examples/pinwheel.mp4 with the paper's chain
#   tools/models/check.sh CLIP [TRUTH]         # another clip; TRUTH is a capture or a transforms file to compare with
#   FRONTEND=moge+raft WEIGHTS="raft-things moge-2-l-normal" tools/models/check.sh
#
# MINUTE4D is the program (default: target/release/minute4d, built if it is not there), with minute4d-lab beside it. FRONTEND is what geometry runs with
# (default: the paper's chain), OPTIONS are more options of `minute4d geometry`, such as "--device gpu --end 1". WEIGHTS are the names that
# must be here (default: those that the front end takes). Whatever else is here is verified too. OUT keeps the capture.
#
# A table of what was checked and what was missing comes last. The exit code is 0 only if everything asked for was checked.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

clip=${1:-examples/pinwheel.mp4}
truth=${2:-}
frontend=${FRONTEND:-megasam+raft+depth-anything+unidepth}
program=${MINUTE4D:-target/release/minute4d}
lab=$(dirname "$program")/minute4d-lab
case $frontend in
    megasam) usual="megasam" ;;
    megasam+raft+depth-anything+unidepth) usual="megasam raft-things depth-anything-v1-l unidepth-v2-l" ;;
    megasam+raft+moge) usual="megasam raft-things moge-2-l" ;;
    moge+raft) usual="moge-2-l raft-things" ;;
    raft) usual="raft-things" ;;
    *) usual="" ;;
esac
wanted=${WEIGHTS-$usual}

if [ -z "${MINUTE4D:-}" ] && [ ! -x "$program" ]; then
    echo "== build" >&2
    cargo build --release -p minute4d_cli -p minute4d_lab --features minute4d_cli/full >&2 || exit 69
fi
[ -x "$program" ] || { echo "there is no program $program: build it (cargo build --release -p minute4d_cli --features full), or set MINUTE4D" >&2; exit 66; }
command -v python3 >/dev/null || { echo "python3 is needed to read the program's reports" >&2; exit 69; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
rows=()
failed=0
# why a command failed: the program's own line, else the last
reason() { grep -m 1 -E '^(minute4d|error): ' "$1" || tail -n 1 "$1"; }
row() { rows+=("$(printf '%-24s %-9s %s' "$1" "$2" "$3")"); }

# --- the files of weights
"$program" weights list --json >"$work/list.json" || exit $?
# name, here or missing, licence, command that gets it: a line each
python3 - "$work/list.json" >"$work/list.tsv" <<'PY' || exit 65
import json, sys
for line in open(sys.argv[1]):
    event = json.loads(line)
    if event["event"] == "result":
        for row in event["result"]:
            kind = row["licence"] if row["commercial"] else "non-commercial: " + row["licence"]
            print(row["name"], "here" if row["path"] else "missing", kind, row["command"], sep="\t")
PY
for name in $wanted; do
    cut -f1 "$work/list.tsv" | grep -qxF "$name" || { echo "no weights are named $name; see minute4d weights list" >&2; exit 2; }
done
while IFS=$'\t' read -r name state licence command; do
    case " $wanted " in *" $name "*) asked=1 ;; *) asked=0 ;; esac
    if [ "$state" = missing ]; then
        if [ $asked = 1 ]; then
            failed=1
            row "$name" MISSING "$command"
        fi
    elif "$program" weights verify "$name" >"$work/verify" 2>"$work/errors"; then
        row "$name" ok "$(sed "s/^$name: //" "$work/verify" | head -n 1); licence: $licence"
    else
        failed=1
        row "$name" FAILED "$(reason "$work/errors")"
    fi
done <"$work/list.tsv"

# --- the front end, with these files
out=${OUT:-$work/capture}
echo "== minute4d geometry $clip --frontend $frontend ${OPTIONS:-}" >&2
start=$SECONDS
# word by word, as they were given
# shellcheck disable=SC2086
if "$program" geometry "$clip" -o "$out" --frontend "$frontend" ${OPTIONS:-} 2>"$work/errors" >&2; then
    row "geometry" ok "$clip with $frontend, $((SECONDS - start)) s"
    made=1
else
    failed=1
    made=0
    row "geometry" FAILED "$(reason "$work/errors")"
fi

# --- against what is true
if [ -z "$truth" ]; then
    row "reference cameras" "not asked" "give a capture or a transforms file as the second argument"
elif [ $made = 0 ]; then
    row "reference cameras" MISSING "there is no capture to compare"
elif "$lab" eval-geometry "$out" --truth "$truth" >"$work/scores" 2>"$work/errors"; then
    row "reference cameras" ok "$truth"
else
    failed=1
    row "reference cameras" FAILED "$(reason "$work/errors")"
fi

[ -s "$work/scores" ] && { echo; cat "$work/scores"; }
echo
printf '%-24s %-9s %s\n' "what" "result" "detail"
printf '%s\n' "${rows[@]}"
if [ $failed = 0 ]; then
    echo "everything that was asked for was checked"
else
    echo "not everything that was asked for could be checked: see MISSING and FAILED"
fi
exit $failed
