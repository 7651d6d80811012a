"""Results as arrays, and renders of the splats."""

from __future__ import annotations

import json
import shutil
import struct
import zlib
from pathlib import Path

import minute4d
import numpy as np
import pytest
from minute4d import Category, Minute4dError, _png
from numpy.typing import NDArray


def psnr_db(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    return float(-10 * np.log10(np.mean((a.astype(float) - b.astype(float)) ** 2) / 255**2))


def test_arrays_have_their_shapes(scene: minute4d.Scene) -> None:
    n, cameras = 12, scene.cameras
    assert (len(cameras), cameras.width, cameras.height) == (n, 240, 180)
    assert cameras.intrinsics.shape == (n, 3, 3) and cameras.c2w.shape == (n, 4, 4)
    turns = cameras.c2w[:, :3, :3]
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (n, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(turns), 1)
    assert scene.times[0] == 0 and np.all(np.diff(scene.times) > 0)
    # 96 frames at 24 per second.
    assert scene.times[-1] == pytest.approx(scene.duration_s) == pytest.approx(95 / 24)
    assert scene.depth.shape == scene.masks.shape == (n, 180, 240)
    assert scene.depth.dtype == np.float32 and scene.masks.dtype == np.bool_
    assert np.nanmin(scene.depth) > 0 and np.isfinite(scene.depth).mean() > 0.9
    assert 0.02 < scene.masks.mean() < 0.3
    assert scene.metric is False
    assert [path.is_file() for path in scene.image_paths] == [True] * n


def test_cameras_and_depth_agree_with_each_other(scene: minute4d.Scene) -> None:
    """Static points of the first frame have the depth of the sixth where they are in it."""
    k, c2w = scene.cameras.intrinsics, scene.cameras.c2w
    y, x = np.nonzero(~scene.masks[0] & np.isfinite(scene.depth[0]))
    z = scene.depth[0][y, x].astype(float)
    rays = np.stack([x + 0.5, y + 0.5, np.ones(len(x))]) * z
    points = c2w[0, :3, :3] @ np.linalg.inv(k[0]) @ rays + c2w[0, :3, 3:]
    to_sixth = np.linalg.inv(c2w[5])
    u, v, depth = k[5] @ (to_sixth[:3, :3] @ points + to_sixth[:3, 3:])
    column, row = np.floor(u / depth).astype(int), np.floor(v / depth).astype(int)
    inside = (column >= 0) & (column < 240) & (row >= 0) & (row < 180) & (depth > 0)
    column, row, depth = column[inside], row[inside], depth[inside]
    valid = ~scene.masks[5][row, column] & np.isfinite(scene.depth[5][row, column])
    error = np.abs(scene.depth[5][row, column] / depth - 1)[valid]
    assert valid.sum() > 10_000 and np.median(error) < 0.02


def test_renders_look_like_the_frames(scene: minute4d.Scene) -> None:
    images = scene.render(scene.cameras, scene.times)
    assert images.shape == (12, 180, 240, 3) and images.dtype == np.uint8
    frames = _png.read(scene.image_paths)
    own = [psnr_db(a, b) for a, b in zip(images, frames, strict=True)]
    other = [psnr_db(a, b) for a, b in zip(images, np.roll(frames, 3, axis=0), strict=True)]
    assert min(own) > 20 and np.mean(own) > np.mean(other) + 5, (own, other)


def test_one_camera_is_used_for_all_times_and_one_time_for_all_cameras(
    scene: minute4d.Scene,
) -> None:
    frozen = scene.render(scene.cameras[[2, 5]], 1.0)
    held = scene.render(scene.cameras[5], [1.0, 2.0])
    assert frozen.shape == held.shape == (2, 180, 240, 3)
    np.testing.assert_array_equal(frozen[1], held[0])
    assert np.mean(held[0] != held[1]) > 0.01
    with pytest.raises(ValueError, match="3 times for 2 cameras"):
        scene.render(scene.cameras[:2], [0, 1, 2])


def test_size_and_lens_are_those_of_the_cameras(scene: minute4d.Scene) -> None:
    lens = scene.cameras.intrinsics[:1] * [[2, 1, 2], [1, 2, 2], [1, 1, 1]]
    large = minute4d.Cameras(lens, scene.cameras.c2w[:1], 480, 360)
    image = scene.render(large, 0.0)
    assert image.shape == (1, 360, 480, 3)
    half = image[0].reshape(180, 2, 240, 2, 3).mean((1, 3)).astype(np.uint8)
    assert psnr_db(half, scene.render(scene.cameras[0], 0.0)[0]) > 25
    with pytest.raises(ValueError, match=r"\(n, 4, 4\)"):
        minute4d.Cameras(lens, scene.cameras.c2w[0], 480, 360)
    with pytest.raises(ValueError, match="intrinsics are not"):
        scene.render(minute4d.Cameras(lens + 1, large.c2w, 480, 360), 0.0)


def test_times_outside_the_clip_are_refused(scene: minute4d.Scene) -> None:
    for time in (-0.1, 4.0, float("nan")):
        with pytest.raises(Minute4dError, match="outside the clip") as failed:
            scene.render(scene.cameras[0], time)
        assert failed.value.category == Category.USAGE
        with pytest.raises(Minute4dError, match="outside the clip"):
            scene.splats(time)


def test_splats_are_in_front_of_the_camera_where_the_depth_is(scene: minute4d.Scene) -> None:
    splats = scene.splats(0.0)
    n = len(splats)
    assert n > 10_000
    assert splats.positions.shape == splats.scales.shape == splats.colours.shape == (n, 3)
    assert splats.rotations.shape == (n, 4) and splats.opacities.shape == (n,)
    assert splats.harmonics.shape[0::2] == (n, 3)
    np.testing.assert_allclose(np.linalg.norm(splats.rotations, axis=1), 1, atol=1e-5)
    assert 0 <= splats.opacities.min() and splats.opacities.max() <= 1 and splats.scales.min() > 0
    spread = np.linalg.eigvalsh(splats.covariances()[:100].astype(float))
    np.testing.assert_allclose(spread, np.sort(splats.scales[:100].astype(float) ** 2), rtol=1e-2)

    k, to_camera = scene.cameras.intrinsics[0], np.linalg.inv(scene.cameras.c2w[0])
    points = to_camera[:3, :3] @ splats.positions.T + to_camera[:3, 3:]
    u, v = (k @ points)[:2] / points[2]
    inside = (points[2] > 0) & (0 <= u) & (u < 240) & (0 <= v) & (v < 180)
    depth = scene.depth[0][v[inside].astype(int), u[inside].astype(int)]
    error = np.abs(points[2][inside] / depth - 1)
    assert np.nanmedian(error) < 0.1
    # Colours are those of the pixels.
    frame = _png.read(scene.image_paths[:1])[0] / 255
    near = error < 0.02
    pixels = frame[v[inside].astype(int), u[inside].astype(int)][near]
    assert np.median(np.abs(splats.colours[inside][near] - pixels)) < 0.1


def test_dynamic_splats_move(scene: minute4d.Scene) -> None:
    a, b = scene.splats(1.0), scene.splats(2.0)
    assert len(a) != len(b) or not np.array_equal(a.positions, b.positions)


def test_capture_alone_has_arrays_and_no_splats(scene: minute4d.Scene) -> None:
    capture = minute4d.load(scene.folder / "capture")
    np.testing.assert_allclose(capture.cameras.c2w, scene.cameras.c2w, atol=1e-9)
    np.testing.assert_allclose(capture.cameras.intrinsics, scene.cameras.intrinsics)
    np.testing.assert_allclose(capture.times, scene.times)
    np.testing.assert_array_equal(capture.masks, scene.masks)
    with pytest.raises(Minute4dError, match="no splats"):
        capture.render(capture.cameras[0], 0.0)


def test_scene_without_a_capture_renders(scene: minute4d.Scene, tmp_path: Path) -> None:
    shutil.copy(scene.folder / "scene.safetensors", tmp_path)
    alone = minute4d.load(tmp_path)
    np.testing.assert_array_equal(
        alone.render(alone.cameras[3], 1.0), scene.render(scene.cameras[3], 1.0)
    )
    assert alone.image_paths == [] and alone.metric is None
    with pytest.raises(Minute4dError, match="no capture"):
        _ = alone.depth


def test_what_is_no_result_is_refused(scene: minute4d.Scene, tmp_path: Path) -> None:
    with pytest.raises(Minute4dError, match="neither") as failed:
        minute4d.load(tmp_path)
    assert failed.value.category == Category.NO_INPUT
    stored = (scene.folder / "scene.safetensors").read_bytes()
    for damaged in (b"", stored[:100], stored[:3000], b"\xff" * 4000):
        (tmp_path / "scene.safetensors").write_bytes(damaged)
        with pytest.raises(Minute4dError) as failed:
            minute4d.load(tmp_path)
        assert failed.value.category == Category.BAD_INPUT
    capture = tmp_path / "capture"
    capture.mkdir()
    listed = json.loads((scene.folder / "capture" / "transforms_train.json").read_text())
    listed["frames"][0]["file_path"] = "../../elsewhere.png"
    (capture / "transforms_train.json").write_text(json.dumps(listed))
    with pytest.raises(Minute4dError, match="outside the capture"):
        minute4d.load(capture)
    (capture / "transforms_train.json").write_text('{"frames": []}')
    with pytest.raises(Minute4dError, match="minute4d import"):
        minute4d.load(capture)


def png(pixels: NDArray[np.uint8], filters: list[int], bits: int, colour: int) -> bytes:
    """Write bytes of pixels (h, w, bytes per pixel), a filter per row, byte by byte as the
    standard describes it (PNG, section 9)."""
    h, w, size = pixels.shape
    rows = bytearray()
    for r in range(h):
        rows.append(filters[r])
        for c in range(w):
            for b in range(size):
                left = int(pixels[r, c - 1, b]) if c else 0
                up = int(pixels[r - 1, c, b]) if r else 0
                corner = int(pixels[r - 1, c - 1, b]) if r and c else 0
                near = left + up - corner
                paeth = min((left, up, corner), key=lambda p: abs(near - p))
                guess = [0, left, up, (left + up) // 2, paeth][filters[r]]
                rows.append((int(pixels[r, c, b]) - guess) % 256)

    def chunk(name: bytes, data: bytes) -> bytes:
        crc = zlib.crc32(name + data)
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", crc)

    header = struct.pack(">IIBBBBB", w, h, bits, colour, 0, 0, 0)
    packed = zlib.compress(bytes(rows))
    parts = [chunk(b"IHDR", header), chunk(b"IDAT", packed[:9]), chunk(b"IDAT", packed[9:])]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts) + chunk(b"IEND", b"")


@pytest.mark.parametrize(("bits", "colour", "size"), [(8, 0, 1), (8, 2, 3), (16, 0, 2), (8, 6, 4)])
def test_every_filter_of_png_is_undone(tmp_path: Path, bits: int, colour: int, size: int) -> None:
    random = np.random.default_rng(7)
    paths, wanted = [], []
    for i, (h, w) in enumerate([(9, 5)] * 3):
        smooth = random.integers(0, 9, (h, w, size)).cumsum(0).cumsum(1)
        pixels = (smooth if i else random.integers(0, 256, (h, w, size))).astype(np.uint8)
        path = tmp_path / f"{i}.png"
        path.write_bytes(png(pixels, [int(f) for f in random.integers(0, 5, h)], bits, colour))
        paths.append(path)
        wanted.append(pixels.view(">u2").astype(np.uint16) if bits == 16 else pixels)
    np.testing.assert_array_equal(_png.read(paths), np.stack(wanted))
    for h, w in [(1, 1), (1, 6), (6, 1)]:
        pixels = random.integers(0, 256, (h, w, size)).astype(np.uint8)
        paths[0].write_bytes(png(pixels, [4] * h, bits, colour))
        read = _png.read(paths[:1])[0]
        np.testing.assert_array_equal(read, pixels.view(">u2") if bits == 16 else pixels)


def test_damaged_png_is_refused(tmp_path: Path) -> None:
    good = png(np.zeros((4, 4, 1), np.uint8), [0] * 4, 8, 0)
    path = tmp_path / "image.png"
    changed = [good[:i] + bytes([good[i] ^ 0x55]) + good[i + 1 :] for i in range(len(good) - 12)]
    for data in [b"", *(good[:n] for n in range(0, len(good) - 12, 5)), *changed]:
        path.write_bytes(data)
        with pytest.raises(Minute4dError, match="image.png"):
            _png.read([path])
    with pytest.raises(Minute4dError) as failed:
        _png.read([tmp_path / "absent.png"])
    assert failed.value.category == Category.NO_INPUT
