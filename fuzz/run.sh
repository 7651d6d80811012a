#!/usr/bin/env bash
# Fuzzes families of readers for SECONDS each, one after another, and prints a table. Usage: fuzz/run.sh SECONDS [FAMILY...]
# Needs nightly Rust and cargo-fuzz.
set -uo pipefail
cd "$(dirname "$0")"
seconds=${1:?usage: fuzz/run.sh SECONDS [FAMILY...]}
shift
families=("$@")
if [ ${#families[@]} = 0 ]; then
    families=(fuzz_targets/*.rs)
    families=("${families[@]##*/}")
    families=("${families[@]%.rs}")
fi
for name in "${families[@]}"; do
    cargo +nightly fuzz build --fuzz-dir . "$name" || exit 1
done
bin=${CARGO_TARGET_DIR:-$PWD/target}/x86_64-unknown-linux-gnu/release
# a constant of a crate that is linked twice is no fault of a reader
export TMPDIR=$PWD/tmp/$$ RAYON_NUM_THREADS=1 ASAN_OPTIONS=detect_odr_violation=0
mkdir -p "$TMPDIR"
trap 'rm -rf "$TMPDIR"' EXIT
printf '%-12s %12s %8s\n' family executions crashes
crashed=0
for name in "${families[@]}"; do
    mkdir -p "corpus/$name" "artifacts/$name"
    # what is left of the time after a crash goes on behind it
    end=$((SECONDS + seconds)) executions=0 before=0
    while left=$((end - SECONDS)) && [ "$left" -gt 0 ]; do
        # no other program decodes what ours does not
        PATH=/nonexistent "$bin/$name" "corpus/$name" -max_total_time="$left" -rss_limit_mb=2048 -malloc_limit_mb=768 -timeout=20 \
            -max_len=65536 -detect_leaks=0 -artifact_prefix="artifacts/$name/" -print_final_stats=1 >"$TMPDIR/log" 2>&1
        status=$?
        n=$(grep -o 'number_of_executed_units: *[0-9]*' "$TMPDIR/log" | grep -o '[0-9]*$')
        executions=$((executions + ${n:-0}))
        [ $status = 0 ] && break
        grep -E '^reader: |panicked|ERROR|SUMMARY' "$TMPDIR/log" >>"artifacts/$name.log"
        grep -A1 -m1 panicked "$TMPDIR/log" | tail -n 1 >>"artifacts/$name.log"
        now=$(find "artifacts/$name" -type f | wc -l)
        if [ "$now" = "$before" ]; then
            echo "$name did not run:" && tail -n 5 "$TMPDIR/log" && exit 1
        fi
        before=$now
        [ "$now" -ge 10 ] && break
    done
    crashes=$(find "artifacts/$name" -type f | wc -l)
    crashed=$((crashed + crashes))
    printf '%-12s %12d %8d\n' "$name" "$executions" "$crashes"
done
echo "$crashed crashes"
[ "$crashed" = 0 ]
