#!/usr/bin/env bash
# A Slurm cluster of two machines on this one, to try arrays, requeues and failures on. Needs root, slurm-wlm and munge.
#
#   tools/slurm/cluster.sh start   [DIR]          # munged, slurmctld and the nodes gn1 and gn2; nothing if they run
#   tools/slurm/cluster.sh status  [DIR]          # what runs; exit code 0 if all of it does
#   tools/slurm/cluster.sh stop    [DIR]          # all of it ends, by process id; DIR stays, to be looked at
#   tools/slurm/cluster.sh env     [DIR]          # eval "$(tools/slurm/cluster.sh env)": sbatch, squeue, ... talk to it
#   tools/slurm/cluster.sh kill-node  gn1 [DIR]   # as if the plug were pulled: every process there gets SIGKILL at once
#   tools/slurm/cluster.sh start-node gn1 [DIR]   # and it comes back
#   tools/slurm/cluster.sh hide       gn1 [DIR]   # the folder that HIDE names is not mounted there, and so is empty ...
#   tools/slurm/cluster.sh show       gn1 [DIR]   # ... and is mounted again
#
# A machine is a set of Linux namespaces (mounts, processes, host name) around one slurmd: `hostname` says gn1 there, its
# process ids and mounts are its own, and it dies whole. Everything else, file systems above all, is shared, as it is on a real cluster. DIR is CLUSTER_DIR or /tmp/minute4d-slurm, and is owned by the cluster.
#
# CLUSTER_CPUS (2) is the number of processors that a node says it has, whether or not they exist; CLUSTER_PORT (17000) the first of three ports. Each node has one "gpu".
set -uo pipefail

usage() { sed -n '2,/^set/{/^set/d;s/^# \{0,1\}//;p}' "${BASH_SOURCE[0]}" >&2; exit 2; }
die() { echo "cluster: $*" >&2; exit 1; }

[ $# -ge 1 ] || usage
command=$1
shift
node=
case $command in
    start | stop | status | env) ;;
    kill-node | start-node | hide | show)
        node=${1:-}
        case $node in gn1 | gn2) shift ;; *) die "$command: which node, gn1 or gn2?" ;; esac
        ;;
    *) usage ;;
esac
dir=${1:-${CLUSTER_DIR:-/tmp/minute4d-slurm}}
port=${CLUSTER_PORT:-17000}
export SLURM_CONF=$dir/slurm.conf

# The process that DIR/$1.pid names, if it is alive and still ours: the kernel may have given the number away since.
alive() {
    local pid
    read -r pid 2>/dev/null < "$dir/$1.pid" && [ -n "$pid" ] && tr '\0' ' ' 2>/dev/null < "/proc/$pid/cmdline" | grep -qF -- "$dir" && echo "$pid"
}

# end NAME SIGNAL: ends it, waits until it is gone (10 s, then SIGKILL).
end() {
    local pid
    pid=$(alive "$1") || { rm -f "$dir/$1.pid"; return 0; }
    kill "-$2" "$pid"
    for _ in $(seq 100); do kill -0 "$pid" 2>/dev/null || break; sleep 0.1; done
    kill -KILL "$pid" 2>/dev/null
    rm -f "$dir/$1.pid"
}

check() {
    local missing=() tool
    for tool in munged slurmctld slurmd sbatch scontrol unshare nsenter; do
        command -v "$tool" > /dev/null || missing+=("$tool")
    done
    [ ${#missing[@]} = 0 ] || die "not found: ${missing[*]}. Install them: apt-get install slurm-wlm munge util-linux"
    [ "$(id -u)" = 0 ] || die "must be root: the machines are namespaces with mounts of their own"
    unshare --mount --pid --uts --fork true 2>/dev/null || die "this kernel or container allows no namespaces (unshare --mount --pid --uts): run it in a virtual machine"
    case $dir in /*) ;; *) die "$dir: DIR must be an absolute path" ;; esac
    [ ${#dir} -le 80 ] || die "$dir: too long for a socket's path (80 characters at most)"
}

configure() {
    mkdir -p "$dir"/{munge,state,log} || die "$dir cannot be made"
    chmod 755 "$dir" "$dir"/{munge,state,log}
    [ -s "$dir/munge/key" ] || (umask 077 && head -c 1024 /dev/urandom > "$dir/munge/key") || die "$dir/munge/key cannot be written"
    cat > "$dir/slurm.conf" <<END
ClusterName=minute4d
SlurmctldHost=$(hostname -s)(127.0.0.1)
SlurmctldPort=$port
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
CredType=cred/munge
# A job that lost its machine waits until its old credentials have expired, and a second; the default is 120 s.
AuthInfo=socket=$dir/munge/socket,cred_expire=${CLUSTER_REQUEUE_SECONDS:-15}
StateSaveLocation=$dir/state
SlurmdSpoolDir=$dir/spool.%n
SlurmctldPidFile=$dir/slurmctld.own.pid
SlurmdPidFile=$dir/slurmd.%n.own.pid
SlurmctldLogFile=$dir/log/slurmctld
SlurmdLogFile=$dir/log/slurmd.%n
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SlurmdParameters=config_overrides
ReturnToService=2
SlurmctldTimeout=10
SlurmdTimeout=10
KillWait=30
JobRequeue=1
GresTypes=gpu
NodeName=gn1 NodeAddr=127.0.0.1 Port=$((port + 1)) CPUs=${CLUSTER_CPUS:-2} RealMemory=8000 Gres=gpu:1
NodeName=gn2 NodeAddr=127.0.0.1 Port=$((port + 2)) CPUs=${CLUSTER_CPUS:-2} RealMemory=8000 Gres=gpu:1
PartitionName=main Nodes=gn1,gn2 Default=YES MaxTime=INFINITE State=UP OverSubscribe=NO
END
    # Distinct files, since no file may be two nodes' device.
    cat > "$dir/gres.conf" <<END
NodeName=gn1 Name=gpu File=/dev/null
NodeName=gn2 Name=gpu File=/dev/zero
END
}

# The first process of a node: its name, slurmd, and a parent for what slurmd leaves behind.
read -r -d '' machine <<'END'
dir=$1 name=$2
hostname "$name" || exit 1
slurmd -D -N "$name" -f "$dir/slurm.conf" &
wait $!
END

start_node() {
    alive "$1" > /dev/null && return 0
    mkdir -p "$dir/spool.$1"
    # Without the words that would tell the machine that it is inside a job or a shell of somebody's.
    env -i PATH="$PATH" HOME="${HOME:-/root}" SLURM_CONF="$SLURM_CONF" unshare --mount --pid --uts --fork --mount-proc --kill-child \
        bash -c "$machine" machine "$dir" "$1" < /dev/null >> "$dir/log/$1" 2>&1 &
    echo $! > "$dir/$1.pid"
    disown
}

# Process 1 of the node, seen from here: the child of unshare.
first_process() { local pid; pid=$(alive "$1") && cat "/proc/$pid/task/$pid/children"; }

# ready SECONDS: both nodes take jobs.
ready() {
    local stop=$((SECONDS + $1)) states
    while [ $SECONDS -lt $stop ]; do
        states=$(sinfo -h -N -o '%T' 2>/dev/null | tr '\n' ' ')
        [[ $states =~ ^((idle|mixed|allocated|completing)\ ){2}$ ]] && return 0
        sleep 0.5
    done
    return 1
}

status() {
    local whole=0 name
    for name in munged slurmctld gn1 gn2; do
        if alive "$name" > /dev/null; then echo "$name runs, process $(alive "$name")"; else echo "$name does not run"; whole=1; fi
    done
    alive slurmctld > /dev/null && { sinfo -N -o '%N %T %C %G %E' || whole=1; squeue -h -t all | awk '{n[$5]++} END {for (s in n) print "jobs " s ": " n[s]}'; }
    return $whole
}

case $command in
start)
    check
    if status > /dev/null && ready 1; then echo "the cluster runs already in $dir" >&2; exit 0; fi
    alive slurmctld > /dev/null || configure
    if ! alive munged > /dev/null; then
        munged --key-file "$dir/munge/key" --socket "$dir/munge/socket" --pid-file "$dir/munge/own.pid" --log-file "$dir/log/munged" \
            --seed-file "$dir/munge/seed" --foreground < /dev/null >> "$dir/log/munged.start" 2>&1 &
        echo $! > "$dir/munged.pid"
        disown
        for _ in $(seq 50); do [ -S "$dir/munge/socket" ] && break; sleep 0.1; done
    fi
    alive munged > /dev/null || die "munged does not start: $(tail -n 3 "$dir/log/munged.start")"
    if ! alive slurmctld > /dev/null; then
        slurmctld -D -c -f "$SLURM_CONF" < /dev/null >> "$dir/log/slurmctld.start" 2>&1 &
        echo $! > "$dir/slurmctld.pid"
        disown
    fi
    start_node gn1
    start_node gn2
    if ! ready 40; then
        status >&2
        tail -n 5 "$dir"/log/* >&2
        die "the nodes are not ready after 40 s; see $dir/log. Ports $port to $((port + 2)) must be free (CLUSTER_PORT)"
    fi
    echo "the cluster runs in $dir; eval \"\$(${BASH_SOURCE[0]} env $dir)\" and use sbatch, squeue, scontrol" >&2
    ;;
stop)
    alive slurmctld > /dev/null && timeout 10 scancel --quiet --user=root 2>/dev/null
    # unshare --kill-child: with it goes process 1 of the node, and with that one everything in it.
    for name in gn1 gn2; do end $name KILL; done
    end slurmctld TERM
    end munged TERM
    ;;
status) status ;;
env) echo "export SLURM_CONF='$SLURM_CONF'" ;;
kill-node)
    alive "$node" > /dev/null || die "$node does not run"
    first=$(first_process "$node")
    # The kernel kills all of a process namespace when its first process dies.
    kill -KILL $first || die "$node: process $first cannot be killed"
    end "$node" KILL
    ;;
start-node)
    alive munged > /dev/null || die "the cluster does not run: tools/slurm/cluster.sh start"
    alive "$node" > /dev/null && die "$node runs already"
    start_node "$node"
    ready 40 || die "$node is not back after 40 s: $(tail -n 3 "$dir/log/slurmd.$node")"
    ;;
hide | show)
    first=$(first_process "$node") || die "$node does not run"
    [ -d "${HIDE:-}" ] || die "$command: HIDE must name a folder"
    if [ $command = hide ]; then
        nsenter --target $first --mount --pid mount -t tmpfs none "$HIDE" || die "$node: $HIDE cannot be hidden"
    else
        nsenter --target $first --mount --pid umount --lazy "$HIDE" || die "$node: $HIDE cannot be shown"
    fi
    ;;
esac
