#!/usr/bin/env python3
"""Measures the processor time of each thread of a command (Linux only).

    tools/gpu/host.py -- minute4d train capture -o out --device gpu:0 --iterations 400

On a software Vulkan driver kernels run in threads of the driver (llvmpipe); what the others take is what a step costs the host on any
Vulkan device. Threads of one name are added up. Run it with two numbers of iterations: the difference is that of the steps.
"""

import os
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path


def main():
    command = [word for i, word in enumerate(sys.argv[1:]) if i > 0 or word != "--"]
    if not command:
        sys.exit(__doc__)
    program = subprocess.Popen(command)
    times = {}
    while program.poll() is None:
        time.sleep(0.02)
        try:
            tasks = os.listdir(f"/proc/{program.pid}/task")
        except OSError:
            continue
        for task in tasks:
            folder = Path(f"/proc/{program.pid}/task/{task}")
            try:
                name = (folder / "comm").read_text().strip()
                times[task] = name, int((folder / "schedstat").read_text().split()[0]) / 1e9
            except (OSError, ValueError, IndexError):
                continue  # ended meanwhile
    sums = defaultdict(float)
    for name, seconds in times.values():
        sums[name] += seconds
    for name, seconds in sorted(sums.items(), key=lambda item: -item[1]):
        print(f"{seconds:8.2f} s  {name}")
    return program.returncode


if __name__ == "__main__":
    sys.exit(main())
