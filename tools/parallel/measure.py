#!/usr/bin/env python3
"""Measures how well a command of minute4d would use more cores than this machine has.

    tools/parallel/measure.py --cores 16 -- target/release/minute4d geometry clip.mp4 -o capture

The command gets `--json --threads CORES`. Every hundredth of a second the tool counts the threads that run or want to run (state R
in /proc, Linux only). Where r of them do, this machine does min(r, cores here) seconds of work in a second, and a machine with CORES such
cores would do min(r, CORES): from this follow, for each step that the program reports, the seconds on CORES cores, and how many of them only one
thread has work. Steps are named by the progress that the program reported last, so that the work between two steps counts for the first.

What it does not know: memory and caches are shared by more cores there, and threads that look for work before they sleep count
as if they had some. It is an estimate, a little too optimistic.
"""

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

PERIOD_S = 0.01


def descendants(pid):
    """Returns `pid` and the processes that it started, as far as they still run."""
    out, left = [], [pid]
    while left:
        pid = left.pop()
        out.append(pid)
        try:
            for task in os.listdir(f"/proc/{pid}/task"):
                left += map(int, Path(f"/proc/{pid}/task/{task}/children").read_text().split())
        except OSError:
            pass  # ended meanwhile
    return out


def runnable(pids):
    """Returns the number of threads of `pids` that run or want to run."""
    count = 0
    for pid in pids:
        try:
            tasks = os.listdir(f"/proc/{pid}/task")
        except OSError:
            continue
        for task in tasks:
            try:
                with open(f"/proc/{pid}/task/{task}/stat", "rb") as file:
                    stat = file.read()
            except OSError:
                continue
            # the name, in parentheses, may hold anything
            count += stat[stat.rfind(b")") + 2 :][:1] == b"R"
    return count


class Steps:
    """Reads the events of the program and knows the step it is in."""

    def __init__(self, stream):
        self.stage = "start"
        self.phase = ""
        self.stream = stream

    def follow(self):
        for line in self.stream:
            try:
                event = json.loads(line)
            except ValueError:
                continue
            if event.get("event") == "stage":
                started = event.get("status") in ("started", "resumed")
                self.stage, self.phase = (event["stage"], "") if started else ("between stages", "")
            elif event.get("event") == "progress":
                self.phase = event["phase"]

    @property
    def name(self):
        return f"{self.stage}: {self.phase}" if self.phase else self.stage


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cores", type=int, default=16, help="cores of the machine to estimate (default: 16)")
    parser.add_argument("command", nargs=argparse.REMAINDER)
    args = parser.parse_args()
    command = [word for i, word in enumerate(args.command) if i > 0 or word != "--"]
    if not command:
        parser.error("no command")
    here = len(os.sched_getaffinity(0))

    program = subprocess.Popen(command + ["--json", "--threads", str(args.cores)], stdout=subprocess.PIPE, text=True)
    steps = Steps(program.stdout)
    threading.Thread(target=steps.follow, daemon=True).start()
    table, pids, turn, before = {}, [], 0, time.monotonic()
    while program.poll() is None:
        time.sleep(PERIOD_S)
        if turn % 10 == 0:
            pids = descendants(program.pid)
        turn += 1
        now, wanting = time.monotonic(), runnable(pids)
        seconds, before = now - before, now
        row = table.setdefault(steps.name, [0.0, 0.0, 0.0, 0.0])
        work = seconds * min(wanting, here)
        there = work / min(wanting, args.cores) if wanting else seconds
        row[0] += seconds
        row[1] += work
        row[2] += there
        row[3] += there if wanting <= 1 else 0.0

    print(f"| step | s on {here} cores | core seconds | s on {args.cores} cores, estimated | of these with one thread |")
    print("|---|---:|---:|---:|---:|")
    total = [sum(column) for column in zip(*table.values())]
    for name, row in [*table.items(), ("all", total)]:
        print(f"| {name} | " + " | ".join(f"{value:.2f}" for value in row) + " |")
    return program.returncode


if __name__ == "__main__":
    sys.exit(main())
