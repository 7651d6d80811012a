"""A scene of the example clip, made once by the installed program."""

from __future__ import annotations

from pathlib import Path

import minute4d
import pytest

CLIP = Path(__file__).parents[2] / "examples" / "pinwheel.mp4"
SMALL = {"max_frames": 12, "size": 240, "iterations": 20, "device": "cpu"}


@pytest.fixture(scope="session")
def events() -> list[minute4d.Event]:
    return []


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory, events: list[minute4d.Event]) -> minute4d.Scene:
    out = tmp_path_factory.mktemp("run") / "scene"
    events.extend(minute4d.run(CLIP, out, **SMALL))
    return minute4d.load(out)
