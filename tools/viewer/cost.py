#!/usr/bin/env python3
"""What `train --view` costs: seconds and CPU seconds without it, with it, and with a page open.

The page is played by a client that hears the events and fetches every scene, but draws nothing: drawing takes the
CPU, or the GPU, of whoever looks. Runs alternate; the least of each sort counts. CPU seconds are those of the whole
run, initialisation included, and hold on a busy machine too; those of the wall clock do not.

    tools/viewer/cost.py target/release/minute4d CAPTURE [--iterations 1000] [--repeats 3]
"""

import argparse
import json
import os
import pathlib
import subprocess
import tempfile
import threading
import urllib.parse
import urllib.request

SORTS = ("without --view", "--view, no page", "--view, a page open")


def follow(url, counts):
    """Hears the events until they end, and fetches what they announce."""
    parts = urllib.parse.urlsplit(url)
    address = lambda path: parts._replace(path=path).geturl()
    try:
        with urllib.request.urlopen(address("/events")) as events:
            for line in events:
                if not line.startswith(b"data: "):
                    continue
                event = json.loads(line[6:])
                if event["event"] == "end":
                    return
                if event["event"] == "scene":
                    with urllib.request.urlopen(address("/scene")) as scene:
                        counts["bytes"] += len(scene.read())
                    counts["scenes"] += 1
    except (ConnectionError, urllib.error.URLError):
        pass  # the run has ended


def train(program, capture, iterations, sort):
    """Wall-clock and CPU seconds of the stage of training, and what the page was sent."""
    counts = {"scenes": 0, "bytes": 0}
    with tempfile.TemporaryDirectory() as folder:
        command = [program, "train", capture, "-o", folder + "/out", "--iterations", str(iterations), "--no-viewer", "--json"]
        if sort != SORTS[0]:
            command += ["--view", "--no-open"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        page = None
        for line in process.stdout:
            event = json.loads(line)
            if event["event"] == "view" and sort == SORTS[2]:
                page = threading.Thread(target=follow, args=(event["url"], counts))
                page.start()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"{' '.join(command)} failed with {process.returncode}")
        if page:
            page.join()
        record = json.loads(pathlib.Path(folder, "out/run.json").read_text())
        return record["stages"]["train"]["seconds"], usage.ru_utime + usage.ru_stime, counts


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("capture")
    parser.add_argument("--iterations", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    best = {}
    for _ in range(arguments.repeats):
        for sort in SORTS:
            wall, cpu, counts = train(arguments.program, arguments.capture, arguments.iterations, sort)
            print(f"  {sort}: {wall:.2f} s, {cpu:.2f} s of CPU, {counts['scenes']} scenes", flush=True)
            old = best.get(sort, (float("inf"), float("inf"), counts))
            best[sort] = (min(wall, old[0]), min(cpu, old[1]), max(counts, old[2], key=lambda c: c["scenes"]))
    base = best[SORTS[0]]
    print("| | training, s | | of CPU, the whole run, s | | scenes sent | MB |\n|---|---:|---:|---:|---:|---:|---:|")
    for sort, (wall, cpu, counts) in best.items():
        more = [f"{100 * (now / before - 1):+.1f} %" for now, before in ((wall, base[0]), (cpu, base[1]))]
        megabytes = counts["bytes"] / 1e6
        print(f"| {sort} | {wall:.2f} | {more[0]} | {cpu:.2f} | {more[1]} | {counts['scenes']} | {megabytes:.1f} |")


if __name__ == "__main__":
    main()
