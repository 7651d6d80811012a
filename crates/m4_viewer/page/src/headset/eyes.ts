/**
 * Where the eyes of a headset are in the scene.
 *
 * A headset tells poses in metres, in a space of its own with the axes of OpenGL and gravity along -y. That space is
 * laid into the scene so that the head begins at the camera of the moment and looks where it looks, but level: a
 * tilted floor makes people ill.
 */

import type { Lens } from "../camera/path";
import { type Pose, type Quat, type Vec3, add, axis, cross, dot, poseOf, quatMul, quatUnit, rotate, scale, sub, unit } from "../maths";

/** Where the space of the headset lies in the scene. */
export interface Anchor {
  readonly pose: Pose;
  /** Units of the scene a metre. */
  readonly perMetre: number;
}

/** Half of the field of view for which splats are ordered, radians: an eye's, and what a head turns meanwhile. */
const ORDER_HALF_FOV = (70 * Math.PI) / 180;
/** Side of the image for which they are ordered, pixels: no splat is dropped for its size. */
const ORDER_SIDE = 4096;

/** A pose of the headset (column-major 4x4, axes of OpenGL, metres) with our axes. */
export function poseOfHeadset(matrix: ArrayLike<number>): Pose {
  const sign = [1, -1, -1, 1];
  const at = (row: number, column: number): number => (sign[row] ?? 1) * (sign[column] ?? 1) * (matrix[4 * column + row] ?? 0);
  return poseOf([0, 1, 2, 3].flatMap((row) => [0, 1, 2, 3].map((column) => at(row, column))));
}

/** The rotation that looks where `pose` looks, without pitch and roll. */
function level(pose: Pose, up: Vec3): Quat {
  const flat = (v: Vec3): Vec3 => sub(v, scale(up, dot(v, up)));
  // straight down or up: the way of the image's upper edge
  const ahead = axis(pose, 2);
  const way = Math.abs(dot(ahead, up)) < 0.99 ? ahead : scale(axis(pose, 1), dot(ahead, up) < 0 ? -1 : 1);
  const z = unit(flat(way));
  const y = scale(up, -1);
  const x = cross(y, z);
  return poseOf([x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, 0, 0, 0, 1]).rotation;
}

const inverse = (q: Quat): Quat => [q[0], -q[1], -q[2], -q[3]];

/** Lays the space of the headset so that `head` is at `camera`; `up` is against gravity in the scene. */
export function anchorAt(camera: Pose, up: Vec3, head: Pose, perMetre: number): Anchor {
  const rotation = quatUnit(quatMul(level(camera, up), inverse(level(head, [0, -1, 0]))));
  const position = sub(camera.position, scale(rotate(rotation, head.position), perMetre));
  return { pose: { rotation, position }, perMetre };
}

/** A pose of the headset in the scene. */
export function inScene({ pose, perMetre }: Anchor, eye: Pose): Pose {
  return {
    rotation: quatUnit(quatMul(pose.rotation, eye.rotation)),
    position: add(pose.position, scale(rotate(pose.rotation, eye.position), perMetre)),
  };
}

/** The lens of a column-major projection matrix of OpenGL, for an image of that size. */
export function lensOfProjection(projection: ArrayLike<number>, width: number, height: number): Lens {
  const p = (k: number): number => projection[k] ?? 0;
  return {
    fx: (p(0) * width) / 2,
    fy: (p(5) * height) / 2,
    cx: ((1 - p(8)) * width) / 2,
    cy: ((1 + p(9)) * height) / 2,
    width,
    height,
  };
}

/** The lens for which splats are chosen and ordered, for both eyes. */
export function orderLens(): Lens {
  const f = ORDER_SIDE / 2 / Math.tan(ORDER_HALF_FOV);
  return { fx: f, fy: f, cx: ORDER_SIDE / 2, cy: ORDER_SIDE / 2, width: ORDER_SIDE, height: ORDER_SIDE };
}
