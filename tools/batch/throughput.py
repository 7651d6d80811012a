#!/usr/bin/env python3
"""Clips per hour and core with one worker and with two, and the share of the time in which no stage works.

    tools/batch/throughput.py target/release/minute4d [--clips 8] [-- OPTIONS OF batch plan]

One worker has two threads; of two workers each has one. Makes clips of examples/pinwheel.mp4 (needs ffmpeg) in a temporary folder.
"""
import argparse
import json
import pathlib
import shlex
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
SMALL = ["--iterations", "300", "--set", "dense.working_side_px=160", "--set", "preview.panel_px=160"]


def seconds_of_stages(results):
    """Seconds in stages, and from a job's lease to its publication, over all clips."""
    stages = made = 0.0
    for record in results.glob("*/run.json"):
        stages += sum(stage["seconds"] for stage in json.loads(record.read_text())["stages"].values())
    for state in (results / ".state").glob("*.json"):
        made += json.loads(state.read_text())["seconds"]
    return stages, made


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--clips", type=int, default=8)
    ours, _, options = " ".join(map(shlex.quote, sys.argv[1:])).partition(" -- ")
    args = parser.parse_args(shlex.split(ours))
    args.options = shlex.split(options)
    program, options = str(pathlib.Path(args.program).resolve()), args.options or SMALL
    work = pathlib.Path(tempfile.mkdtemp(prefix="throughput-"))
    try:
        clip = ROOT / "tools/slurm/clip.py"
        subprocess.run([sys.executable, clip, work / "clips", str(args.clips), "--bad", "-1"], check=True, stdout=subprocess.DEVNULL)
        print("| workers x threads | clips | seconds | clips an hour and core | seconds a clip | outside of stages |\n|---|---|---|---|---|---|")
        for workers, threads in [(1, 2), (2, 1), (1, 1)]:
            manifest, results = work / f"{workers}x{threads}.jsonl", work / f"{workers}x{threads}"
            plan = [program, "batch", "plan", work / "clips", "-o", manifest, "--out", results, *options]
            subprocess.run([str(part) for part in plan], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            run = [program, "batch", "run", "--manifest", str(manifest), "--threads", str(threads), "--quiet"]
            start = time.monotonic()
            at_work = [subprocess.Popen(run, stdout=subprocess.DEVNULL) for _ in range(workers)]
            codes = [child.wait() for child in at_work]
            took = time.monotonic() - start
            assert not any(codes), codes
            stages, made = seconds_of_stages(results)
            print(
                f"| {workers} x {threads} | {args.clips} | {took:.0f} | {args.clips * 3600 / took / (workers * threads):.0f} "
                f"| {made / args.clips:.1f} | {100 * (1 - stages / (took * workers)):.1f} % |",
                flush=True,
            )
    finally:
        shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    main()
