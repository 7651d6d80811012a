#!/usr/bin/env python3
"""A batch on Ray: one Ray task a job; the program keeps the books.

    pip install ray
    ray_batch.py jobs.jsonl JOBS [--cpus 2] [--gpus 0] [--address auto] [--program minute4d]
"""

import argparse
import subprocess
import sys

import ray

TRY_AGAIN, POISON, ATTEMPTS = 75, 65, 20


class TryAgain(Exception):
    """The machine could not, another may: the program's exit code 75."""


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("manifest")
    parser.add_argument("jobs", type=int, help="how many jobs the manifest has")
    parser.add_argument("--cpus", type=float, default=2)
    parser.add_argument("--gpus", type=float, default=0)
    parser.add_argument("--address", help="`auto` for a running cluster; without it Ray starts one here")
    parser.add_argument("--program", default="minute4d")
    given = parser.parse_args()
    ray.init(address=given.address, log_to_driver=False)

    @ray.remote(num_cpus=given.cpus, num_gpus=given.gpus, max_retries=ATTEMPTS, retry_exceptions=[TryAgain])
    def work(index):
        command = [given.program, "batch", "run", "--manifest", given.manifest, "--index", str(index)]
        code = subprocess.run(command, stdin=subprocess.DEVNULL).returncode
        if code == TRY_AGAIN or code < 0:
            raise TryAgain(f"job {index}: exit code {code}")
        return code

    left = {work.remote(index): index for index in range(given.jobs)}
    codes = {}
    while left:
        (ended,), _ = ray.wait(list(left), num_returns=1)
        index = left.pop(ended)
        try:
            codes[index] = ray.get(ended)
        except (TryAgain, ray.exceptions.RayError) as error:
            codes[index] = TRY_AGAIN
            print(f"job {index}: given up: {error}", file=sys.stderr)
    for index in sorted(codes):
        print(f"job {index}: exit code {codes[index]}")
    return TRY_AGAIN if TRY_AGAIN in codes.values() else max(codes.values(), default=0)


sys.exit(main())
