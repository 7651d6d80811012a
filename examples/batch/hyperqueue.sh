#!/usr/bin/env bash
# A batch on HyperQueue: task I does job I of the manifest (the program reads HQ_TASK_ID).
#
#   hq server start &  hq worker start &      # or: hq alloc add slurm ...
#   examples/batch/hyperqueue.sh jobs.jsonl JOBS
#
# HyperQueue starts a task again when its worker was lost, but not when it ended with a code; so that the code 75 (try
# again) is tried again here. CPUS (2) and PROGRAM (minute4d) may be set.
set -euo pipefail

manifest=$(realpath -- "${1:?which manifest?}")
jobs=${2:?how many jobs does it have?}

# What one task runs. As it ends by the program's own code, 65 (the clip cannot work) shows as a failed task.
task='
for try in 1 2 3 4 5; do
    "$1" batch run --manifest "$2" && exit 0 || code=$?
    [ "$code" = 75 ] || exit "$code"
    sleep $((try * 10))
done
exit 75'

exec hq submit --name minute4d --array "0-$((jobs - 1))" --cpus "${CPUS:-2}" --crash-limit 20 --wait \
    -- bash -c "$task" task "${PROGRAM:-minute4d}" "$manifest"
