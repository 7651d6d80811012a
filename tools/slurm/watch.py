#!/usr/bin/env python3
"""Watches a folder of results while a batch runs, until SIGTERM: what appears there must be whole, and appear once.

    tools/slurm/watch.py RESULTS LOG

LOG gets a JSON object a line: `published` (id, when) whenever a folder appears under a final name or is another one than
before, `broken` where such a folder has no `run.json`, one that is not `finished`, or lacks a file that `run.json` lists
(at its size). A look takes milliseconds; between looks 50 ms pass, so that a shorter flaw may be missed.
"""

import json
import pathlib
import signal
import sys
import time


def identity(folder):
    """Tells one folder under a name from the next under the same name."""
    try:
        record = (folder / "run.json").stat()
        return folder.stat().st_ino, record.st_ino, record.st_mtime_ns
    except FileNotFoundError:
        return None


def flaw(folder):
    """What is wrong with a result that can be seen; None if nothing is."""
    try:
        record = json.loads((folder / "run.json").read_text())
    except FileNotFoundError:
        return "no run.json"
    except ValueError as error:
        return f"run.json does not parse: {error}"
    if record.get("status") != "finished":
        return f"run.json says {record.get('status')}"
    for name, file in record["files"].items():
        path = folder / name
        if not path.exists() or path.stat().st_size != file["bytes"]:
            return f"{name} is not as recorded"
    return None


def main():
    results, log = pathlib.Path(sys.argv[1]), open(sys.argv[2], "a", buffering=1)
    seen, going = {}, [True]
    signal.signal(signal.SIGTERM, lambda *_: going.clear())

    def tell(event, **more):
        print(json.dumps({"time": time.time(), "event": event, **more}), file=log)

    tell("begin")
    while True:
        last = not going
        folders = [f for f in results.iterdir() if f.is_dir() and not f.name.startswith(".")] if results.is_dir() else []
        for folder in folders:
            before = identity(folder)
            if before is not None and seen.get(folder.name) == before:
                continue
            wrong = flaw(folder)
            # It may have been swapped for another, or taken away, as it was read: only what stayed counts.
            if identity(folder) != before or not folder.exists():
                continue
            if not wrong:
                tell("published", id=folder.name)
            elif seen.get(folder.name) != wrong:
                tell("broken", id=folder.name, reason=wrong)
            seen[folder.name] = wrong or before
        if last:
            break
        time.sleep(0.05)
    tell("end")


main()
