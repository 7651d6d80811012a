/** The eyes of a headset in the scene. */

import { expect, test } from "vitest";
import { anchorAt, inScene, lensOfProjection, poseOfHeadset } from "../src/headset/eyes";
import { type Pose, type Vec3, axis, axisAngle, dot, matrixOf, poseOf, quatMul } from "../src/maths";

const UP: Vec3 = [0, -1, 0];
/** Column-major, axes of OpenGL: at that place, turned to the left about the upward axis. */
const head = (place: Vec3, turn: number): number[] => {
  const [c, s] = [Math.cos(turn), Math.sin(turn)];
  return [c, 0, -s, 0, 0, 1, 0, 0, s, 0, c, 0, ...place, 1];
};
const close = (a: Vec3, b: Vec3): void => a.forEach((v, i) => expect(v).toBeCloseTo(b[i] ?? 0, 9));

test("a headset's axes become ours", () => {
  const pose = poseOfHeadset(head([1, 2, 3], 0));
  close(pose.position, [1, -2, -3]);
  close(axis(pose, 2), [0, 0, 1]);
  // turned to the left, it looks along -x
  close(axis(poseOfHeadset(head([0, 0, 0], Math.PI / 2)), 2), [-1, 0, 0]);
});

test("the head begins at the camera, looks where it looks, and is level", () => {
  const pitch = axisAngle([1, 0, 0], 0.4);
  const yaw = axisAngle([0, 1, 0], 0.7);
  const camera: Pose = { rotation: quatMul(yaw, pitch), position: [3, 1, -2] };
  const seen = poseOfHeadset(head([0.3, 1.7, -0.2], 1.1));
  const anchor = anchorAt(camera, UP, seen, 2.5);
  const begin = inScene(anchor, seen);
  close(begin.position, camera.position);
  close(axis(begin, 2), axis({ ...camera, rotation: yaw }, 2));
  close(axis(begin, 1), [0, 1, 0]);
  // a step of 10 cm up is a step of 0.25 units against gravity
  const higher = inScene(anchor, poseOfHeadset(head([0.3, 1.8, -0.2], 1.1)));
  close(higher.position, [3, 1 - 0.25, -2]);
});

test("a camera that looks straight down has a level head, too", () => {
  const camera: Pose = { rotation: axisAngle([1, 0, 0], -Math.PI / 2), position: [0, -3, 0] };
  expect(dot(axis(camera, 2), UP)).toBeCloseTo(-1, 9);
  const seen = poseOfHeadset(head([0, 1.6, 0], 0));
  const begin = inScene(anchorAt(camera, UP, seen, 1), seen);
  close(axis(begin, 1), [0, 1, 0]);
  // ahead is where the upper edge of the image was
  close(axis(begin, 2), axis(poseOf(matrixOf(camera)), 1).map((v) => -v) as unknown as Vec3);
});

test("a projection is a lens", () => {
  // a field of view of 45 degrees to the left, 30 to the right, 40 up and 50 down
  const [left, right, up, down] = [45, 30, 40, 50].map((a) => Math.tan((a * Math.PI) / 180)) as [number, number, number, number];
  const projection = [
    ...[2 / (right + left), 0, 0, 0, 0, 2 / (up + down), 0, 0],
    ...[(right - left) / (right + left), (up - down) / (up + down), -1, -1, 0, 0, -0.1, 0],
  ];
  const lens = lensOfProjection(projection, 100, 80);
  expect([-left * lens.fx + lens.cx, right * lens.fx + lens.cx].map((v) => Math.round(1e6 * v) / 1e6)).toEqual([0, 100]);
  expect([-up * lens.fy + lens.cy, down * lens.fy + lens.cy].map((v) => Math.round(1e6 * v) / 1e6)).toEqual([0, 80]);
});
