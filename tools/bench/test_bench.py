"""Tests of the scenes' motion, cameras and lists; neither Blender nor scikit-image is needed, numpy is.

    python3 -m unittest discover tools/bench
"""

import importlib.util
import itertools
import json
import pathlib
import tempfile
import unittest

import draw
import kinds
import numpy as np
import thin
import views
import write
from paths import ClosedPath
from scene import Clip, Scene
from shapes import Mesh, Primitive
from transforms import apply, quaternion, rotation, segment, slerp

HAS_BULLET = importlib.util.find_spec("pybullet") is not None
if not HAS_BULLET:
    print("test_bench.py: pybullet is missing, so quad and toys are left out; pip install -r tools/bench/requirements.txt")
# Numbers from 7 on are for reporting: no check may choose by them.
NUMBERS = range(1, 7)


def scenes(names, clip=Clip(), numbers=NUMBERS):
    """The scenes of these kinds and numbers that this machine can make."""
    for kind, number in itertools.product(names, numbers):
        if kind not in ("quad", "toys") or HAS_BULLET:
            yield Scene(f"{kind}-{number}", clip)


def state(scene, seconds):
    """Matrices and vertices of all parts at a time, in one array."""
    subject = scene.subject
    deformed = [part.vertices(seconds).ravel() for part in subject.parts if part.vertices]
    return np.concatenate([np.array(subject.pose(seconds)).ravel(), *deformed])


def points(scene, seconds, instance=None):
    """World vertices of the meshes and spheres of an instance, or of all."""
    found = []
    for part, matrix in zip(scene.subject.parts, scene.subject.pose(seconds), strict=True):
        if instance in (None, part.instance):
            vertices = part.vertices(seconds) if part.vertices else corners(part.shape)
            found.append(apply(matrix, vertices))
    return np.concatenate(found)


def corners(shape):
    """The vertices of a mesh; the corners of the bounding box of a cylinder."""
    if isinstance(shape, Mesh):
        return shape.vertices
    assert isinstance(shape, Primitive) and shape.kind == "cylinder", shape
    half = np.array([shape.arguments["radius"]] * 2 + [shape.arguments["depth"] / 2])
    return np.array(list(itertools.product((-1, 1), repeat=3))) * half


class Motion(unittest.TestCase):
    def test_pose_depends_on_seconds_alone(self):
        slow, fast = Clip(96, 24), Clip(240, 60)
        for a, b in zip(scenes(kinds.NAMES, slow, (1, 2)), scenes(kinds.NAMES, fast, (1, 2)), strict=True):
            # Backwards in one of them: a pose does not depend on earlier ones.
            wanted = [state(a, slow.seconds(2 * k)) for k in range(40)]
            got = [state(b, fast.seconds(5 * k)) for k in reversed(range(40))]
            np.testing.assert_allclose(np.array(got[::-1]), np.array(wanted), atol=1e-9, err_msg=a.name)

    def test_every_instance_moves_and_poses_are_finite(self):
        for scene in scenes(kinds.NAMES):
            instances = {part.instance for part in scene.subject.parts}
            self.assertEqual(instances, set(range(1, len(scene.subject.names) + 1)), scene.name)
            for instance in instances:
                parts = [i for i, part in enumerate(scene.subject.parts) if part.instance == instance]
                moved = []
                for seconds in np.arange(0, 4, 0.25):
                    matrices = np.array(scene.subject.pose(seconds))[parts]
                    shapes = [scene.subject.parts[i].vertices for i in parts]
                    moved.append(np.concatenate([matrices.ravel(), *(v(seconds).ravel() for v in shapes if v)]))
                self.assertTrue(np.isfinite(moved).all(), scene.name)
                self.assertGreater(np.ptp(moved, axis=0).max(), 0.1, f"{scene.name}, instance {instance}")

    def test_steps_of_a_sixtieth_are_small(self):
        for scene in scenes(kinds.FREE):
            centres = np.array([points(scene, i / 60)[::7] for i in range(100)])
            speed = np.linalg.norm(np.diff(centres, axis=0), axis=2).max() * 60
            self.assertLess(speed, 8.0, f"{scene.name}: {speed} m/s")

    def test_objects_stay_above_the_ground_and_in_the_free_space(self):
        for scene in scenes(kinds.FREE):
            for seconds in np.arange(0, 10, 0.37):
                world = points(scene, seconds)
                low, high = world.min(0), world.max(0)
                self.assertGreater(low[2], -0.02, f"{scene.name} at {seconds}")
                self.assertTrue((low[:2] > (-1.5, -1.15)).all() and (high < (1.5, 0.95, 2.3)).all(), f"{scene.name} {low} {high}")

    def test_different_numbers_are_different_scenes(self):
        for kind in kinds.FREE:
            states = [state(Scene(f"{kind}-{n}", Clip()), 1.0).sum() for n in NUMBERS]
            self.assertEqual(len({round(s, 6) for s in states}), len(NUMBERS), kind)


class Kinds(unittest.TestCase):
    def test_pendulums_hang_free(self):
        for scene in scenes(["pendulum"]):
            lowest = min(points(scene, s)[:, 2].min() for s in np.arange(0, 6, 0.2))
            self.assertGreater(lowest, 0.25, scene.name)

    def test_single_pendulum_keeps_its_energy(self):
        from kinds.pendulum import GRAVITY, Swing, single

        swing = Swing(single(0.9), [0.5, 0.3, 0.2, -0.8])

        def energy(state):
            a, b, da, db = state
            speed2 = 0.81 * (da * da + (np.cos(a) * db) ** 2)
            return speed2 / 2 - GRAVITY * 0.9 * np.cos(a) * np.cos(b)

        self.assertAlmostEqual(energy(swing.at(8.0)), energy(swing.at(0.0)), places=3)

    def test_wheels_roll_without_slipping(self):
        for scene in scenes(["cart"]):
            wheels = [i for i, part in enumerate(scene.subject.parts) if part.shape.vertices[:, 1].max() < 0.05]
            self.assertGreaterEqual(len(wheels), 4)
            for seconds in (0.3, 1.7, 3.1):
                dt = 1e-4
                before, after = (scene.subject.pose(seconds + k * dt) for k in (-1, 1))
                # The rear wheels: what touches the ground has no velocity along the wheel's plane.
                for i in wheels[:2]:
                    middle = scene.subject.pose(seconds)[i]
                    touching = middle[:3, 3] - (0, 0, middle[2, 3])
                    local = np.linalg.inv(middle) @ (*touching, 1)
                    velocity = ((after[i] - before[i]) @ local)[:3] / (2 * dt)
                    axle = middle[:3, 1]
                    rolling = np.cross(axle, (0, 0, 1))
                    self.assertLess(abs(velocity @ rolling), 0.06, scene.name)

    def test_feet_stay_where_they_are_set_down(self):
        for scene in scenes(["walker"]):
            feet = [i for i, part in enumerate(scene.subject.parts) if len(part.shape.faces) == 6]
            self.assertEqual(len(feet), 2)
            times = np.arange(0, 4, 1 / 120)
            paths = np.array([[scene.subject.pose(s)[i][:3, 3] for i in feet] for s in times])
            step = np.linalg.norm(np.diff(paths, axis=0), axis=2)
            planted = (step < 1e-6).mean(0)
            self.assertTrue(((planted > 0.5) & (planted < 0.7)).all(), f"{scene.name}: {planted}")

    def test_bones_keep_their_lengths(self):
        from kinds.walker import bent

        hip, ankle = np.array([0.1, 0.2, 0.6]), np.array([0.25, 0.2, 0.1])
        knee = bent(hip, ankle, 0.3, 0.28, np.array([1.0, 0.0, 0.0]))
        self.assertAlmostEqual(np.linalg.norm(knee - hip), 0.3)
        self.assertAlmostEqual(np.linalg.norm(knee - ankle), 0.28)
        self.assertGreater(knee[0], 0.17)

    def test_a_pushed_crate_stays_within_its_frame(self):
        from kinds.contact import pushed

        cycles = np.linspace(0, 3, 3001)
        frame = -0.5 * np.cos(2 * np.pi * cycles)
        crate = np.array([pushed((f, c % 1 < 0.5), 0.5, 0.1) for f, c in zip(frame, cycles)])
        self.assertLessEqual(np.abs(crate - frame).max(), 0.1 + 1e-9)
        self.assertLess(np.abs(np.diff(crate)).max(), np.abs(np.diff(frame)).max() + 1e-9)
        rests = np.diff(crate) == 0
        self.assertTrue(0.1 < rests.mean() < 0.6)

    def test_original_kinds_are_the_first_scenes(self):
        # Focal length for 480 pixels and first camera centre, from the lists of the scenes that docs/results.md is about.
        first = {
            "mill-1": (96, 374.7145912638419, (1.139105200767517, -2.534701347351074, 1.1042792797088623)),
            "quad-1": (64, 389.2812120542379, (-1.1281193494796753, -2.629061698913574, 1.084234595298767)),
            "toys-1": (64, 411.16714842620127, (1.1822463274002075, -2.5946831703186035, 1.0731576681137085)),
        }
        for name, (frames, focal_px, eye) in first.items():
            if name == "quad-1" and not HAS_BULLET:
                continue
            scene = Scene(name, Clip(frames))
            self.assertEqual(write.head(scene, 480, 360, {})["fl_x"], focal_px)
            np.testing.assert_allclose(scene.train(0).eye, eye, atol=1e-6)


class Cameras(unittest.TestCase):
    def test_paths_are_finite_and_slow(self):
        for scene in scenes(kinds.NAMES):
            eyes = np.array([scene.train(i).eye for i in range(96)])
            targets = np.array([scene.train(i).target for i in range(96)])
            self.assertTrue(np.isfinite(eyes).all() and np.isfinite(targets).all(), scene.name)
            speed = np.linalg.norm(np.diff(eyes, axis=0), axis=1).max() * 24
            self.assertLess(speed, 2.0, f"{scene.name}: {speed} m/s")
            self.assertGreater(np.ptp(eyes[:48], axis=0).max(), 0.4, f"{scene.name}: parallax within two seconds")

    def test_tripod_is_the_middle_of_the_clip(self):
        moving, fixed = Scene("cart-1", Clip(97)), Scene("cart-1", Clip(97, tripod=True))
        for position in (0, 10.5, 96):
            self.assertEqual(fixed.train(position), moving.train(48))

    def test_near_views_turn_by_their_angle(self):
        scene = Scene("gloss-1", Clip())
        pivot = np.array(scene.rig.focus)[:2]
        for degrees in (-6, -3, 3, 6):
            a, b = (np.array(v.eye)[:2] - pivot for v in (scene.train(7), scene.near(7, degrees)))
            self.assertAlmostEqual(np.degrees(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)), degrees)


class Lists(unittest.TestCase):
    def test_layout(self):
        scene = Scene("cart-1", Clip(9, 24))
        identity = lambda _view: np.eye(4)
        with tempfile.TemporaryDirectory() as folder:
            out = pathlib.Path(folder)
            write.lists(out, write.head(scene, 64, 48, {}), scene, views.SETS, 4, identity)
            read = {name: json.loads((out / file).read_text()) for name, file in views.FILES.items()}
            self.assertEqual(sorted(path.name for path in out.iterdir()), sorted(views.FILES.values()))
            with self.assertRaisesRegex(SystemExit, "rendered in another way"):
                write.lists(out, write.head(scene, 80, 60, {}), scene, ["train"], 4, identity)
        for content in read.values():
            keys = "camera_model fl_x fl_y cx cy w h fps duration_s k1 k2 p1 p2 scene instances rendering frames"
            self.assertEqual(list(content), keys.split())
            self.assertEqual((content["fps"], content["duration_s"], content["cx"]), (24, 8 / 24, 32))
        first = read["train"]["frames"][2]
        self.assertEqual(first["file_path"], "train/00002.jpg")
        self.assertEqual(first["depth_file_path"], "depth/00002.png")
        self.assertEqual((first["mask_path"], first["time"]), ("mask/00002.png", 0.25))
        self.assertEqual(first["transform_matrix"], np.eye(4).tolist())
        self.assertEqual([len(read[name]["frames"]) for name in views.SETS], [9, 6, 6, 2])
        self.assertEqual([f["camera"] for f in read["far"]["frames"]], [0, 1] * 3)
        self.assertEqual([f["degrees"] for f in read["near"]["frames"]], [-3, -6, 3, 6, -3, -6])
        self.assertEqual([f["time"] for f in read["between"]["frames"]], [0.0625, 0.5625])
        self.assertEqual(read["between"]["frames"][0]["mask_path"], "test_mask/b_00000.png")

    def test_unknown_scenes_are_named(self):
        for name in ("train-1", "mill", "mill-x"):
            with self.assertRaisesRegex(SystemExit, "KIND-NUMBER"):
                Scene(name, Clip())


class Draw(unittest.TestCase):
    def test_draw_is_a_function_of_its_seed(self):
        self.assertEqual(draw.draw(1), draw.draw(1))
        self.assertEqual(sorted(draw.KINDS), sorted(kinds.NAMES))
        seen = set()
        for seed in range(200):
            names = [name.split("-") for name in draw.draw(seed)]
            self.assertEqual(len({kind for kind, _ in names}), 4)
            self.assertTrue(all(7 <= int(number) <= 99 for _, number in names))
            seen |= {kind for kind, _ in names}
        self.assertEqual(seen, set(kinds.NAMES))


class Thin(unittest.TestCase):
    def test_a_thinned_scene_holds_out_the_frames_between(self):
        frames = [{"file_path": f"train/{i}.jpg", "depth_file_path": f"depth/{i}.png"} for i in range(7)]
        kept, held_out = thin.thinned({"w": 8, "frames": frames}, 3)
        self.assertEqual(kept, {"w": 8, "frames": [frames[0], frames[3], frames[6]]})
        self.assertEqual([frame["file_path"] for frame in held_out["frames"]], [f"train/{i}.jpg" for i in (1, 2, 4, 5)])
        self.assertFalse(any("depth_file_path" in frame for frame in held_out["frames"]))


class Geometry(unittest.TestCase):
    def test_closed_path(self):
        turn = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
        circle = ClosedPath(0.5 * np.stack([np.cos(turn), np.sin(turn)], 1))
        self.assertAlmostEqual(circle.length_m, np.pi, places=4)
        self.assertAlmostEqual(circle.curvature(1.0), 2.0, places=2)
        self.assertAlmostEqual(circle.heading(np.pi * 2.25) - circle.heading(0), 4.5 * np.pi, places=2)
        np.testing.assert_allclose(circle.beside(0.7, 0.5), (0, 0), atol=1e-3)

    def test_rotations(self):
        half = np.sqrt(0.5)
        np.testing.assert_allclose(quaternion(0, 0, half, half), rotation("Z", np.pi / 2), atol=1e-12)
        np.testing.assert_allclose(slerp((0, 0, 0, 1), (0, 0, -half, -half), 0.5), (0, 0, np.sin(np.pi / 8), np.cos(np.pi / 8)))
        frame = segment((0, 0, 0), (0, 0, 2))
        np.testing.assert_allclose(frame, [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]], atol=1e-12)

    def test_track_visibility(self):
        import tracks

        depth, instance = np.full((4, 6), 2.0), np.ones((4, 6), np.uint8)
        instance[0] = 2
        c2w = np.eye(4)
        # In front, behind the surface, behind the camera, beside the image, on the pixels of another object.
        tested = np.array([[0, 0, -2.0], [0, 0, -2.2], [0, 0, 2.0], [9, 0, -2.0], [0, 0.9, -2.0]])
        seen = tracks.visible(tested, c2w, 4.0, depth, instance, np.ones(5))
        self.assertEqual(seen.tolist(), [True, False, False, False, False])


if __name__ == "__main__":
    unittest.main()
