"""The program of this package: where it is, and how its commands are started."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Union

from ._errors import Category, Minute4dError
from ._events import Events

Option = Union[bool, str, int, float, "os.PathLike[str]", Iterable[str], None]
"""A value of an option: True for a flag; several strings for an option that may be repeated."""


@cache
def program() -> Path:
    """Return the path of the program that was installed with this package.

    Raises `Minute4dError` if it is not where the installer put it.
    """
    name = "minute4d.exe" if sys.platform == "win32" else "minute4d"
    try:
        files = metadata.files("minute4d") or []
    except metadata.PackageNotFoundError:
        files = []
    candidates = [Path(str(file.locate())) for file in files if file.name == name]
    # `pip install --target` moves programs without a note of it.
    candidates.append(Path(__file__).parents[1] / "bin" / name)
    for candidate in candidates:
        if candidate.is_file():
            return candidate.resolve()
    raise Minute4dError(
        Category.NO_DEVICE,
        f"the program {name} of this package is missing (it was expected at "
        f"{candidates[0]}); install minute4d again",
    )


def run(
    clip: Union[str, os.PathLike[str]],
    output: Union[str, os.PathLike[str]],
    **options: Option,
) -> Events:
    """Turn a video into a scene: start ``minute4d run CLIP -o OUTPUT``.

    Options are those of ``minute4d run --help`` with underscores: ``iterations=300``,
    ``resume=True``, ``set=["train.mip=false", "seed=1"]``; those with False or None are left out.
    Iterate over the events, or ``wait()`` for the end. Leaving the iteration stops the program,
    which saves its state first (see `Events`). Failures raise `Minute4dError`.
    """
    return Events(program(), ["run", f"--out={os.fspath(output)}", *words(options), "--", os.fspath(clip)])


def words(options: dict[str, Option]) -> list[str]:
    """Return options as words of the command line."""
    out: list[str] = []
    for name, value in options.items():
        if name in ("json", "out", "help"):
            raise TypeError(f"{name} is not an option here")
        flag = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            out.append(flag)
        elif isinstance(value, (str, int, float, os.PathLike)):
            out.append(f"{flag}={os.fspath(value) if isinstance(value, os.PathLike) else value}")
        else:
            out.extend(f"{flag}={each}" for each in value)
    return out
