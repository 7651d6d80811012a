#!/usr/bin/env bash
# A batch on a Slurm cluster to which everything happens that happens to batches; then the books are checked.
#
#   tools/slurm/drill.sh PROGRAM [CLIPS=40]      # PROGRAM: minute4d; CLIPS: at least 10
#
# On the cluster of two machines of cluster.sh: gn2 has not mounted the clips at first; clip 7 is corrupt; gn1 loses its power in the
# middle of its work and comes back; one task is preempted, one is told that its time is nearly over, one is cancelled by its owner.
# What is left when the queue is empty is submitted once more. Then: every good clip is done, and was published once; the
# bad one is recorded as such and was run once; no part of a result was ever to be seen; `batch status` counts all of it; and running
# every job once more changes nothing. Exit code 0 only if all of that holds. Needs root, slurm-wlm, munge, ffmpeg, jq and
# python3. Everything is in DRILL_DIR (a new folder in /tmp, kept). SETTINGS are the settings of the runs, LIMIT (3600)
# the seconds that it may take in all.
set -uo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)

die() { echo "drill: $*" >&2; exit 1; }
[ $# -ge 1 ] || { sed -n '2,/^set/{/^set/d;s/^# \{0,1\}//;p}' "${BASH_SOURCE[0]}" >&2; exit 2; }
program=$(realpath -- "$1") && [ -x "$program" ] || die "$1: no program"
clips=${2:-40}
[ "$clips" -ge 10 ] || die "$clips clips are too few for all that happens: 10 at least"
for tool in ffmpeg jq python3 scontrol; do
    command -v $tool > /dev/null || die "$tool not found. Install: apt-get install slurm-wlm munge ffmpeg jq python3"
done
dir=${DRILL_DIR:-$(mktemp -d /tmp/minute4d-drill.XXXXXX)}
mkdir -p "$dir" && chmod 755 "$dir" || die "$dir cannot be made"
cluster=$dir/cluster results=$dir/results manifest=$dir/jobs.jsonl logs=$dir/jobs.logs
[ ! -e "$manifest" ] || die "$dir holds a drill already"
read -r -a settings <<< "${SETTINGS:---fov 56 --iterations 1500 --set checkpoint.every_s=2}"
limit=${LIMIT:-3600}
bad=clip-007

watcher=
finish() {
    [ -z "$watcher" ] || kill "$watcher" 2> /dev/null
    "$here/cluster.sh" stop "$cluster"
}
trap finish EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

say() { printf '%02d:%02d  %s\n' $((SECONDS / 60)) $((SECONDS % 60)) "$*" | tee -a "$dir/drill.log"; }
batch() { "$program" --quiet batch "$@"; }
submit() { batch submit --manifest "$manifest" -- --cpus-per-task=1 || die "submitting failed"; }
status() { batch status --manifest "$manifest" --json | jq 'select(.event == "result").result'; }
states() { status | jq -r '[.counts | to_entries[] | select(.value > 0) | "\(.value) \(.key)"] | join(", ")'; }
published() { find "$results" -mindepth 2 -maxdepth 2 -path "$results/[!.]*/run.json" | wc -l; }
at_least() { [ "$(published)" -ge "$1" ]; }
queue_empty() { [ -z "$(squeue -h)" ]; }
put_back() { [ "$(grep -hs 'minute4d: to be tried again' "$logs/$1"_*.log | wc -l)" -ge "$2" ]; }
is_down() { scontrol show node "$1" | grep -q 'State=DOWN'; }
clip() { printf 'clip-%03d' "${1#*_}"; }
list() { paste -sd' ' | sed 's/ /, /g'; }

# until_true SECONDS WHAT COMMAND...: waits for it.
until_true() {
    local stop=$((SECONDS + $1)) what=$2
    shift 2
    [ $stop -lt "$limit" ] || stop=$limit
    until "$@"; do
        [ $SECONDS -lt $stop ] || { squeue -r >&2; die "$what: it did not come to that. See $dir"; }
        sleep 0.5
    done
}

# at_work [squeue's options]: `task` is the task of the array that began last, has saved something, and was left in
# peace so far: it is in its middle.
harmed=
at_work() {
    for task in $(squeue -h -r -j "$main" -t running --sort=-S -o %i "$@"); do
        [[ " $harmed " == *" $task "* ]] && continue
        [ "$(jq -r .status "$results/.work/$(clip "$task")/run.json" 2> /dev/null)" = running ] && return 0
    done
    return 1
}
ended_since_mark() { [ "$results/.state/$(clip "$task").json" -nt "$dir/mark" ]; }

# harm COMMAND...: does it to a task in its middle, and to another one where that one was just done.
harm() {
    local try
    for try in 1 2 3 4 5 6 7 8; do
        until_true 300 "a task is in its middle" at_work
        touch "$dir/mark"
        if ! "$@" "$task" 2> /dev/null; then sleep 1; continue; fi
        until_true 90 "$(clip "$task") ends" ended_since_mark
        harmed+=" $task"
        [ "$(jq -r .outcome "$results/.state/$(clip "$task").json")" = retryable ] && return 0
    done
    die "no task is to be met in its middle: more iterations, by SETTINGS, would help"
}

"$here/cluster.sh" start "$cluster" 2> /dev/null || die "no cluster; ask: $here/cluster.sh start $cluster"
eval "$("$here/cluster.sh" env "$cluster")"
"$here/clip.py" "$dir/clips" "$clips" || die "no clips"
batch plan "$dir/clips" -o "$manifest" --out "$results" "${settings[@]}" > /dev/null || die "planning failed"
mkdir -p "$results"
"$here/watch.py" "$results" "$dir/watch.jsonl" &
watcher=$!
say "$clips clips are planned; $bad is corrupt"

export HIDE=$dir/clips
"$here/cluster.sh" hide gn2 "$cluster" || die "gn2 cannot lose the clips"
main=$(submit)
say "array $main; gn2 has not mounted the clips"
until_true 300 "tasks are put back for want of their clips" put_back "$main" 3
"$here/cluster.sh" show gn2 "$cluster"
say "tasks were put back $(grep -hs 'minute4d: to be tried again' "$logs/$main"_*.log | wc -l) times for want of their clips; gn2 has mounted them"

until_true 1200 "some clips are done" at_least $((clips / 5))
until_true 120 "gn1 is at work" at_work -w gn1
killed=$(squeue -h -r -t running -w gn1 -o %i)
"$here/cluster.sh" kill-node gn1 "$cluster"
say "$(published) are done; gn1 loses its power, and with it $(for task in $killed; do clip "$task"; echo; done | list)"
until_true 120 "Slurm notices" is_down gn1
say "Slurm has noticed"

harm scontrol requeue
say "$(clip "$task") was preempted"
"$here/cluster.sh" start-node gn1 "$cluster" || die "gn1 does not come back"
say "gn1 is back"

until_true 1200 "more clips are done" at_least $((clips / 2))
harm scancel --batch --signal=TERM
say "$(clip "$task") was told that its time is nearly over, and has stopped; $(published) are done"
harm scancel
cancelled=$task
say "$(clip "$task") was cancelled by its owner"

until_true "$limit" "the queue is empty" queue_empty
status > "$dir/first.json"
say "the queue is empty: $(states)"
again=$(submit)
say "submitted once more: array $again"
until_true "$limit" "the queue is empty" queue_empty
say "the queue is empty: $(states)"

sums() { find "$results" -type f -not -path "$results/.*" -exec sha256sum {} + | sort; }
before=$(sums)
last=
for index in $(seq 0 $((clips - 1))); do
    batch run --manifest "$manifest" --index "$index" > /dev/null 2>&1
    last+=" $?"
done
say "every job once more: exit codes$last"
sleep 1
kill "$watcher"
wait "$watcher"
watcher=

failures=0
# holds WHAT COMMAND...: one line of the verdict.
holds() {
    local what=$1
    shift
    if "$@" > /dev/null 2>&1; then say "holds: $what"; else say "DOES NOT HOLD: $what"; failures=$((failures + 1)); fi
}
status > "$dir/status.json"
good=$((clips - 1))
told() { jq -s "$@" "$dir/watch.jsonl"; }
once_in_logs() {
    local i
    for i in $(seq 0 $((clips - 1))); do
        [ "$(grep -hE "clip-$(printf %03d "$i"): done in" "$logs"/*.log | wc -l)" = $([ "$i" = 7 ] && echo 0 || echo 1) ] || return 1
    done
}
taken_up() { grep -lE '"status":"(reused|resumed)"' "$results"/.log/*.txt | xargs -n 1 basename -s .txt; }
no_remains() { [ -z "$(find "$results"/.work "$results"/.incoming "$results"/.outgoing -mindepth 1 2> /dev/null)" ]; }
codes=
for index in $(seq 0 $((clips - 1))); do codes+=" $([ "$index" = 7 ] && echo 65 || echo 0)"; done

holds "all $good good clips are done, $bad failed permanently, and the sum is $clips" \
    jq -e ".jobs == $clips and ([.counts[]] | add) == $clips and .counts.done == $good and .counts.failed == 1" "$dir/status.json"
holds "$bad is the one, with exit code 65" jq -e "[.clips[] | select(.state == \"failed\") | [.id, .code]] == [[\"$bad\", 65]]" "$dir/status.json"
holds "$bad was run once" [ "$(grep -c '^minute4d: ' "$results/.log/$bad.txt")" = 1 ]
holds "every good clip was seen to appear once" told -e "[.[] | select(.event == \"published\") | .id] | length == $good and (unique | length) == $good"
holds "every good clip was finished once by the jobs' own words" once_in_logs
holds "no part of a result was ever seen" told -e '[.[] | select(.event == "broken")] == []'
holds "what had been saved was gone on with, by $(taken_up | list)" [ "$(taken_up | wc -l)" -gt 0 ]
holds "$(clip "$cancelled") stayed cancelled until it was submitted again" jq -e ".clips[] | select(.id == \"$(clip "$cancelled")\") | .state == \"retryable\"" "$dir/first.json"
holds "running every job once more changes nothing" [ "$last" = "$codes" -a "$before" = "$(sums)" ]
holds "nothing half-done is left" no_remains
[ $failures = 0 ] || die "$failures of the promises do not hold. See $dir"
say "all of it holds"
