#!/usr/bin/env bash
# Measures this machine's GPU: kernels and whole steps at three sizes, a complete run, and trainings of 5,000 iterations.
#
#   tools/gpu/measure.sh            # the best GPU; within ten minutes once the program is built
#   GPU=gpu:1 tools/gpu/measure.sh  # the one that `minute4d doctor` lists as 1
#   QUICK=1 GPU=gpu:0 tools/gpu/measure.sh   # a small setting, to see that everything runs
#
# Needs this folder and a driver. MINUTE4D is the program (default: target/release/minute4d, built if it is not there),
# RESULTS where the reports go (default: target/gpu, with the name of the GPU), CAPTURE a capture or benchmark scene to train on
# (default: that of a complete run of examples/pinwheel.mp4, which is timed). What is skipped, and why, is said at the end and in the
# summary; the exit code is 0 if nothing failed.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

gpu=${GPU:-gpu}
results=${RESULTS:-target/gpu}
program=${MINUTE4D:-target/release/minute4d}
work=$(mktemp -d)
watcher=
trap 'rm -rf "$work"; [ -z "$watcher" ] || kill "$watcher" 2>/dev/null' EXIT
failed=()
skipped=()

if [ ! -x "$program" ]; then
    echo "== build" >&2
    cargo build --release -p minute4d_cli --features full >&2 || exit 69
fi

limit=600
if [ -n "${QUICK:-}" ]; then
    cases=("2000 96x72" "4000 128x96")
    steps=1
    iterations=20
    video=(--end 0.7 --size 192 --iterations 20)
    few=(--set init.max_static=1000 --set init.max_dynamic=1000)
else
    cases=("100000 360x480" "200000 854x480" "300000 960x720")
    steps=15
    iterations=5000
    video=()
    few=(--set init.max_static=20000 --set init.max_dynamic=80000)
fi

SECONDS=0
# runs a command within the seconds that it may take and that are left
within() {
    local most=$1 left=$((limit - SECONDS))
    shift
    [ "$left" -ge 10 ] || return 125
    [ "$most" -le "$left" ] || most=$left
    timeout --signal=INT --kill-after=10 "$most" "$@"
}
# says why something did not work; the argument is its exit code
why() {
    case $1 in
    125) echo "the time of all was over" ;;
    124 | 130 | 137) echo "it took too long" ;;
    *) echo "exit code $1" ;;
    esac
}
# the value of a key of a pretty-printed JSON file, the first after lines that hold the other arguments, in their order
value() {
    local file=$1 key=$2
    shift 2
    awk -v key="\"$key\":" -v marks="$(printf '%s\n' "$@")" '
        BEGIN { n = split(marks, mark, "\n"); while (n > 0 && mark[n] == "") n-- }
        at < n { if (index($0, mark[at + 1])) at++; next }
        $1 == key { sub(/^[^:]*: */, ""); gsub(/[",]/, ""); print; exit }' "$file"
}

echo "== doctor" >&2
within 60 "$program" doctor | tee "$work/doctor.txt" >&2 || failed+=("doctor")
day=$(date -u +%F)
# the first GPU that doctor names, in characters that every file system accepts
gpu_name=$(sed -n 's/^gpu *[0-9]*: *\([^(]*\).*/\1/p' "$work/doctor.txt" | head -1 | tr -cs '[:alnum:]' ' ' | tr '[:upper:]' '[:lower:]' | xargs | tr ' ' -)
slug=$day-${gpu_name:-gpu}

for case in "${cases[@]}"; do
    read -r splats size <<<"$case"
    echo "== bench, $splats splats, $size" >&2
    table=$work/bench-$splats-$size.md
    within 90 "$program" bench --device "$gpu" --splats "$splats" --size "$size" --steps "$steps" --quiet >"$table"
    code=$?
    if [ $code -ne 0 ]; then
        failed+=("bench $splats $size: $(why $code)")
        continue
    fi
    sed -n 5,9p "$table" >&2
    mkdir -p "$results"
    cp "$table" "$results/$slug-$splats-$size.md"
done

capture=${CAPTURE:-}
whole=
if [ -z "$capture" ]; then
    echo "== complete run of examples/pinwheel.mp4" >&2
    start=$SECONDS
    within 240 "$program" run examples/pinwheel.mp4 -o "$work/pinwheel" --device "$gpu" --quiet "${video[@]}" >/dev/null
    code=$?
    if [ $code -eq 0 ]; then
        capture=$work/pinwheel/capture
        whole=$((SECONDS - start))
    else
        failed+=("run: $(why $code)")
    fi
fi

# trains with more settings; what it took goes to files of that name
training() {
    local name=$1
    shift
    echo "== $iterations iterations, $name" >&2
    # what the driver says is in use, every half second, where it can be asked
    watcher=
    if command -v nvidia-smi >/dev/null && nvidia-smi >/dev/null 2>&1; then
        nvidia-smi --query-gpu=memory.used --format=csv,noheader,nounits --loop-ms=500 >"$work/$name.memory" 2>/dev/null &
        watcher=$!
    fi
    local start=$SECONDS
    within 240 "$program" train "$capture" -o "$work/$name" --device "$gpu" --iterations "$iterations" --no-viewer --quiet "$@" \
        --set checkpoint.every_s=100000 >/dev/null 2>"$work/$name.err"
    local code=$?
    echo $((SECONDS - start)) >"$work/$name.wall"
    [ -z "$watcher" ] || { kill "$watcher" 2>/dev/null; wait "$watcher" 2>/dev/null; watcher=; }
    if [ $code -ne 0 ]; then
        failed+=("training, $name: $(why $code)")
        tail -5 "$work/$name.err" >&2
    fi
}
if [ -n "$capture" ]; then
    training few "${few[@]}"
    training all
    [ -s "$work/all.memory" ] || skipped+=("memory in use by the driver: there is no nvidia-smi")
else
    skipped+=("training: no capture")
fi

# a row for each key that a training's files have
rows() {
    local name=$1 record=$work/$1/run.json last key found
    [ -f "$record" ] || return
    echo
    echo "## $2"
    echo
    echo "| what | value |"
    echo "|---|---|"
    echo "| status | $(value "$record" status) |"
    echo "| iterations | $(value "$record" iterations '"stages": {') |"
    echo "| static splats at the end | $(value "$record" static '"splats": {') |"
    echo "| dynamic splats at the end | $(value "$record" dynamic '"splats": {') |"
    last=$(tail -1 "$work/$name/metrics.jsonl" 2>/dev/null)
    for key in touched seconds processor_seconds loss psnr; do
        found=$(sed -n "s/.*\"$key\":\([-0-9.eE]*\).*/\1/p" <<<"$last")
        [ -z "$found" ] || echo "| last $key of metrics.jsonl | $found |"
    done
    echo "| initialisation and training, s | $(value "$record" seconds '"stages": {' '"train": {') |"
    echo "| the whole command with preview, s | $(cat "$work/$name.wall") |"
    echo "| peak memory of the host, bytes | $(grep -o '"peak_memory_bytes": [0-9]*' "$record" | grep -o '[0-9]*$' | sort -n | tail -1) |"
    if [ -s "$work/$name.memory" ]; then
        echo "| most memory in use on a GPU of this machine, all programs, MiB | $(sort -n "$work/$name.memory" | tail -1) |"
        echo "| before training, MiB | $(head -1 "$work/$name.memory") |"
    fi
}

summary=$results/$slug-training.md
{
    echo "# Training on a GPU, $day"
    echo
    [ -z "${QUICK:-}" ] || echo "A small setting, to see that everything runs: these are no measurements."
    [ -z "${QUICK:-}" ] || echo
    echo "Asked for: \`--device $gpu\`. Adapters, as \`minute4d doctor\` lists them:"
    echo
    sed -n 's/^gpu *\(.*\)/- \1/p' "$work/doctor.txt"
    if [ -n "$whole" ]; then
        record=$work/pinwheel/run.json
        echo
        echo "## Complete run of examples/pinwheel.mp4: $whole s"
        echo
        echo "| stage | s |"
        echo "|---|---|"
        for stage in geometry enhance train preview viewer; do
            found=$(value "$record" seconds '"stages": {' "\"$stage\": {")
            [ -z "$found" ] || echo "| $stage | $found |"
        done
    fi
    rows few "Training from at most 100,000 splats"
    rows all "Training from as many splats as the capture gives"
    echo
    if [ ${#skipped[@]} -gt 0 ]; then printf 'Skipped: %s\n\n' "${skipped[@]}"; fi
    if [ ${#failed[@]} -gt 0 ]; then printf 'Failed: %s\n\n' "${failed[@]}"; fi
    echo "Everything took $SECONDS s."
} >"$work/summary.md"
mkdir -p "$results"
cp "$work/summary.md" "$summary"
cat "$work/summary.md"
echo "written to $summary; the tables of the bench beside it" >&2
[ ${#failed[@]} -eq 0 ]
