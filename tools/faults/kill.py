#!/usr/bin/env python3
"""Kills runs at random moments, lets them go on, and compares the scenes with that of a run that nobody disturbed.

    tools/faults/kill.py target/release/minute4d --times 50 [--signal KILL|TERM] [--clip CLIP] [--every S] [--seed N]
        [-- RUN-OPTIONS]

Each of the runs is killed once, at a moment spread evenly over the time of the undisturbed one; then every file under its
final name is checked to be whole, and the same command with --resume ends the run. One more run is killed again and again
until it is done, after S/10 to 11 S/10 seconds each time (S is half of the time of the undisturbed run if it is not given). With
TERM it is measured how long the program takes to save and end. Exit code 1 if anything differs.
"""
import argparse
import hashlib
import json
import pathlib
import random
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
SMALL = "video.max_frames=10 dense.working_side_px=160 train.iterations=120 checkpoint.every_s=0.5 preview.panel_px=160".split()


def command(program, clip, out, options):
    return [program, "run", clip, "-o", str(out), "--resume", "--quiet", *options]


def whole(out):
    """Names of files that are there under their final name and are not whole."""
    torn = []
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        if any(part.startswith(".") for part in path.relative_to(out).parts):
            continue
        data = path.read_bytes()
        ends = {".png": b"IEND\xaeB`\x82", ".jpg": b"\xff\xd9", ".html": b"</html>"}
        try:
            if path.suffix == ".json":
                json.loads(data)
            elif path.suffix == ".jsonl":
                assert all(json.loads(line) for line in data.decode().splitlines())
            elif path.suffix == ".safetensors":
                size = int.from_bytes(data[:8], "little")
                tensors = json.loads(data[8 : 8 + size])
                last = max(t["data_offsets"][1] for n, t in tensors.items() if n != "__metadata__")
                assert len(data) == 8 + size + last
            elif path.suffix == ".mp4":
                at, boxes = 0, set()
                while at < len(data):
                    length = int.from_bytes(data[at : at + 4], "big")
                    boxes.add(data[at + 4 : at + 8])
                    assert length >= 8
                    at += length
                assert at == len(data) and {b"moov", b"mdat"} <= boxes
            elif path.suffix in ends:
                assert data.rstrip().endswith(ends[path.suffix])
        except (AssertionError, ValueError, KeyError):
            torn.append(str(path.relative_to(out)))
    return torn


def scene(out):
    return hashlib.sha256((out / "scene.safetensors").read_bytes()).hexdigest()


def stage(out):
    """What the record says of where the run was."""
    try:
        stages = json.loads((out / "run.json").read_text())["stages"]
    except (OSError, ValueError, KeyError):
        return "before the first record"
    open_ = [name for name, s in stages.items() if not s["done"]]
    return open_[-1] if open_ else f"after {list(stages)[-1]}" if stages else "geometry"


def disturb(args, out, options, after):
    """Starts a run and sends the signal after so many seconds: (exit code or None if it was done before, seconds to the end)."""
    child = subprocess.Popen(command(args.program, args.clip, out, options), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        child.wait(after)
        return None, 0.0
    except subprocess.TimeoutExpired:
        pass
    start = time.monotonic()
    child.send_signal(getattr(signal, "SIG" + args.signal))
    code = child.wait()
    return code, time.monotonic() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--times", type=int, default=50)
    parser.add_argument("--signal", choices=["KILL", "TERM"], default="KILL")
    parser.add_argument("--clip", default=str(ROOT / "examples/pinwheel.mp4"))
    parser.add_argument("--every", type=float)
    parser.add_argument("--seed", type=int, default=1)
    ours, _, options = " ".join(map(shlex.quote, sys.argv[1:])).partition(" -- ")
    args = parser.parse_args(shlex.split(ours))
    args.options = shlex.split(options)
    args.program = str(pathlib.Path(args.program).resolve())
    options = args.options or [word for s in SMALL for word in ("--set", s)]
    work = pathlib.Path(tempfile.mkdtemp(prefix="faults-"))
    faults = []
    try:
        start = time.monotonic()
        subprocess.run(command(args.program, args.clip, work / "calm", options), check=True, stdout=subprocess.DEVNULL)
        took, expected = time.monotonic() - start, scene(work / "calm")
        print(f"undisturbed: {took:.1f} s, scene {expected[:16]}", flush=True)
        rng, waits = random.Random(args.seed), []
        for i in range(args.times):
            out, share, code = work / "run", (i + rng.random()) / args.times, None
            # A run that was done before is no kill: the machine was slower when the undisturbed one was timed.
            while code is None:
                shutil.rmtree(out, ignore_errors=True)
                after = took * share
                code, wait = disturb(args, out, options, after)
                took *= 0.9 if code is None else 1.0
            waits.append(wait)
            where, torn = stage(out), whole(out)
            start = time.monotonic()
            again = subprocess.run(command(args.program, args.clip, out, options), capture_output=True, text=True)
            same = again.returncode == 0 and scene(out) == expected
            left = [p.name for p in out.rglob(".*") if p.name != ".minute4d-files.json"]
            good = same and not torn and not left and not whole(out) and (args.signal == "KILL" or code in (0, 143))
            print(
                f"{i + 1:3}  {after:6.2f} s  {where:24} exit {code} in {wait:.2f} s, "
                f"resumed in {time.monotonic() - start:5.1f} s: {'same scene' if same else 'ANOTHER SCENE'}"
                f"{'' if good else f', torn {torn}, left {left}, {again.stderr[-300:]}'}",
                flush=True,
            )
            if not good:
                faults.append(i + 1)
        out, kills = work / "again", 0
        while kills < 200:
            code, wait = disturb(args, out, options, (0.1 + rng.random()) * (args.every or took / 2))
            if code is None:
                break
            kills += 1
            waits.append(wait)
            print(f"killed again in {stage(out)}: ended in {wait:.2f} s", flush=True)
            if whole(out):
                faults.append("again")
        same = (out / "scene.safetensors").exists() and scene(out) == expected
        done = "same scene" if same else "ANOTHER SCENE" if code is None else "not done: it needs longer between two kills"
        print(f"one run killed {kills} times: {done}")
        if not same:
            faults.append("again")
    finally:
        shutil.rmtree(work, ignore_errors=True)
    if waits:
        print(f"seconds from {args.signal} to the end: median {sorted(waits)[len(waits) // 2]:.2f}, most {max(waits):.2f}")
    print(f"{args.times} runs disturbed, {len(faults)} faults {faults or ''}")
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
