"""Starting and stopping the program."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import minute4d
import pytest
from conftest import CLIP, SMALL
from minute4d import Category, Minute4dError
from minute4d._program import program, words


def until_training(events: minute4d.Events) -> None:
    for event in events:
        if event["event"] == "progress" and event["phase"] == "train":
            return
    pytest.fail("training did not begin")


def test_program_is_that_of_this_environment() -> None:
    assert program().is_relative_to(Path(sys.prefix).resolve())
    shown = subprocess.run([program(), "--version"], capture_output=True, text=True, check=True)
    assert shown.stdout.split()[1] == __import__("importlib.metadata").metadata.version("minute4d")


def test_run_tells_its_stages_and_its_result(
    scene: minute4d.Scene, events: list[minute4d.Event]
) -> None:
    assert events[0]["event"] == "start"
    stages = [e["stage"] for e in events if e["event"] == "stage" and e["status"] == "finished"]
    assert stages == ["geometry", "train", "preview", "viewer"]
    assert any(e["event"] == "progress" and e["phase"] == "train" for e in events)
    results = [e["result"] for e in events if e["event"] == "result"]
    assert [Path(r["path"]) for r in results] == [scene.folder]
    assert results[0]["record"]["iterations"] == 20
    assert (scene.folder / "viewer.html").stat().st_size > 100_000


def test_options_become_words() -> None:
    options = {"max_frames": 3, "resume": True, "force": False, "seed": None, "set": ["a=1", "b=2"]}
    assert words(options) == ["--max-frames=3", "--resume", "--set=a=1", "--set=b=2"]
    assert words({"depth": Path("maps")}) == ["--depth=maps"]
    with pytest.raises(TypeError, match="json"):
        words({"json": True})


def test_failures_have_a_category_and_a_message(tmp_path: Path, scene: minute4d.Scene) -> None:
    with pytest.raises(Minute4dError, match="absent.mp4") as failed:
        minute4d.run(tmp_path / "absent.mp4", tmp_path / "out").wait()
    assert failed.value.category == Category.NO_INPUT
    with pytest.raises(Minute4dError, match="--colour") as failed:
        minute4d.run(CLIP, tmp_path / "out", colour=1).wait()
    assert failed.value.category == Category.USAGE
    damaged = tmp_path / "damaged.mp4"
    damaged.write_bytes(CLIP.read_bytes()[:5000])
    with pytest.raises(Minute4dError, match="damaged.mp4") as failed:
        minute4d.run(damaged, tmp_path / "out").wait()
    assert failed.value.category == Category.BAD_INPUT
    with pytest.raises(Minute4dError, match="not empty|exist|finished|--force") as failed:
        minute4d.run(CLIP, scene.folder, **SMALL).wait()
    assert failed.value.category == Category.CANNOT_WRITE
    with pytest.raises(Minute4dError, match="train.nothing") as failed:
        minute4d.run(CLIP, tmp_path / "out", set=["train.nothing=1"]).wait()
    assert failed.value.category == Category.BAD_SETTINGS


def test_leaving_the_iteration_saves_and_resume_gives_the_same_scene(
    scene: minute4d.Scene, tmp_path: Path
) -> None:
    capture, stopped, whole = scene.folder / "capture", tmp_path / "stopped", tmp_path / "whole"
    with minute4d.run(capture, stopped, iterations=100, device="cpu") as events:
        until_training(events)
    assert events._process.returncode == 143
    assert next(events, None) is None
    assert not (stopped / "scene.safetensors").exists()
    resumed = minute4d.run(capture, stopped, iterations=100, device="cpu", resume=True)
    statuses = [e["status"] for e in resumed if e["event"] == "stage" and e["stage"] == "train"]
    assert statuses[1:] == ["resumed", "finished"], statuses
    result = minute4d.run(capture, whole, iterations=100, device="cpu").wait()
    assert Path(result["path"]) == whole
    name = "scene.safetensors"
    assert (stopped / name).read_bytes() == (whole / name).read_bytes()


def test_deleted_iterator_stops_the_program(scene: minute4d.Scene, tmp_path: Path) -> None:
    events = minute4d.run(scene.folder / "capture", tmp_path / "out", iterations=2000, device="cpu")
    until_training(events)
    process = events._process
    del events
    assert process.returncode == 143


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("group", [True, False], ids=["terminal", "python alone"])
def test_ctrl_c_stops_the_program_with_its_state_saved(
    scene: minute4d.Scene, tmp_path: Path, group: bool
) -> None:
    script = (
        "import minute4d, sys\n"
        "for event in minute4d.run(sys.argv[1], sys.argv[2], iterations=5000, device='cpu'):\n"
        "    print(event.get('phase'), flush=True)\n"
    )
    out = tmp_path / "out"
    python = subprocess.Popen(
        [sys.executable, "-c", script, scene.folder / "capture", out],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # tests that run in the background of a shell ignore it
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert python.stdout is not None
    while python.stdout.readline() not in ("train\n", ""):
        pass
    if group:
        os.killpg(python.pid, signal.SIGINT)
    else:
        os.kill(python.pid, signal.SIGINT)
    _, stderr = python.communicate(timeout=60)
    assert "KeyboardInterrupt" in stderr
    assert '"status": "stopped"' in (out / "run.json").read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_program_of_a_killed_python_saves_and_stops(scene: minute4d.Scene, tmp_path: Path) -> None:
    script = (
        "import minute4d, os, signal, sys\n"
        "for event in minute4d.run(sys.argv[1], sys.argv[2], iterations=5000, device='cpu'):\n"
        "    if event.get('phase') == 'train':\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    out = tmp_path / "out"
    subprocess.run([sys.executable, "-c", script, scene.folder / "capture", out], timeout=120)
    until = time.monotonic() + 60
    while '"status": "stopped"' not in (out / "run.json").read_text():
        assert time.monotonic() < until, (out / "run.json").read_text()
        time.sleep(0.1)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_killed_program_is_an_error(scene: minute4d.Scene, tmp_path: Path) -> None:
    events = minute4d.run(scene.folder / "capture", tmp_path / "out", iterations=5000, device="cpu")
    until_training(events)
    events._process.kill()
    with pytest.raises(Minute4dError, match="signal 9") as failed:
        events.wait()
    assert failed.value.category == Category.KILLED
