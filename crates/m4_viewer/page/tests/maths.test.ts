import { expect, test } from "vitest";
import {
  type Pose,
  type Quat,
  type Vec3,
  axis,
  axisAngle,
  distance,
  matrixOf,
  mixPose,
  norm,
  poseOf,
  quatMul,
  quatUnit,
  rotate,
  slerp,
  smoothstep,
  turnAbout,
} from "../src/maths";

const quats: Quat[] = [
  [1, 0, 0, 0],
  [0, 1, 0, 0],
  [0, 0, 1, 0],
  [0, 0, 0, 1],
  quatUnit([0.3, -0.7, 0.2, 0.5]),
  quatUnit([-0.01, 0.99, 0.03, -0.02]),
];

test("a pose goes to a matrix and back, for every branch", () => {
  for (const rotation of quats) {
    const back = poseOf(matrixOf({ rotation, position: [1, 2, 3] }));
    expect(back.position).toEqual([1, 2, 3]);
    const dot = rotation.reduce((s, v, i) => s + v * (back.rotation[i] ?? 0), 0);
    expect(Math.abs(dot)).toBeCloseTo(1, 12);
  }
});

test("the columns of the matrix are the axes", () => {
  const pose: Pose = { rotation: quatUnit([0.3, -0.7, 0.2, 0.5]), position: [0, 0, 0] };
  const m = matrixOf(pose);
  const forward = axis(pose, 2);
  expect([m[2], m[6], m[10]]).toEqual([...forward]);
});

test("a product turns by the right factor first", () => {
  const [a, b] = [axisAngle([0, 0, 1], Math.PI / 2), axisAngle([1, 0, 0], Math.PI / 2)];
  const v: Vec3 = [0, 1, 0];
  const once = rotate(quatMul(a, b), v);
  const twice = rotate(a, rotate(b, v));
  once.forEach((x, i) => expect(x).toBeCloseTo(twice[i] ?? 0, 12));
  expect(rotate(a, [1, 0, 0])[1]).toBeCloseTo(1, 12);
});

test("slerp is the short way at an even pace", () => {
  const a: Quat = [1, 0, 0, 0];
  const b = axisAngle([0, 1, 0], 1);
  const far: Quat = [-b[0], -b[1], -b[2], -b[3]];
  for (const end of [b, far]) {
    const third = slerp(a, end, 1 / 3);
    expect(2 * Math.acos(Math.abs(third[0]))).toBeCloseTo(1 / 3, 9);
  }
});

test("a turn about a point keeps the distance", () => {
  const pose: Pose = { rotation: [1, 0, 0, 0], position: [0, 0, -2] };
  const turned = turnAbout(pose, [0, 0, 1], axisAngle([0, 1, 0], 0.7));
  expect(distance(turned.position, [0, 0, 1])).toBeCloseTo(3, 12);
});

test("poses between two", () => {
  const a: Pose = { rotation: [1, 0, 0, 0], position: [0, 0, 0] };
  const b: Pose = { rotation: axisAngle([0, 0, 1], 1), position: [2, 0, 0] };
  const middle = mixPose(a, b, 0.5);
  expect(middle.position).toEqual([1, 0, 0]);
  expect(norm(rotate(middle.rotation, [1, 0, 0]))).toBeCloseTo(1, 12);
});

test("smoothstep has its ends, also without a width", () => {
  expect([0, 1, 2, 3].map((v) => smoothstep(1, 2, v))).toEqual([0, 0, 1, 1]);
  expect([0.9, 1].map((v) => smoothstep(1, 1, v))).toEqual([0, 1]);
});
