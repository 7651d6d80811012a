/** Turning about a point, coming nearer, shifting: rigid moves of a pose, so that no roll jumps. */

import { type Pose, type Vec3, add, axis, axisAngle, clamp, distance, dot, quatMul, scale, sub, turnAbout } from "../maths";

/** The camera never looks closer to straight up or down than this, radians. */
const POLE = 0.09;

/** What the camera turns about: straight ahead, as far away as the middle of the scene, at most `most`: on a long walk that
 * middle is in another room. */
export function pivotOf(pose: Pose, centre: Vec3, most = Infinity): Vec3 {
  const ahead = axis(pose, 2);
  const depth = dot(sub(centre, pose.position), ahead);
  const far = distance(centre, pose.position);
  return add(pose.position, scale(ahead, Math.max(Math.min(Math.max(depth, 0.25 * far), most), 1e-3)));
}

/** A pitch that keeps the camera off the poles. */
function pitchWithin(pose: Pose, up: Vec3, pitch: number): number {
  const height = Math.acos(clamp(dot(axis(pose, 2), up), -1, 1));
  return clamp(height + pitch, POLE, Math.PI - POLE) - height;
}

/** About `pivot`: `yaw` radians about the upward axis, `pitch` about the camera's own horizontal. */
export function turned(pose: Pose, pivot: Vec3, up: Vec3, yaw: number, pitch: number): Pose {
  // a turn about the axis to the right raises the view for positive angles: downward pitch is
  // negative
  const within = pitchWithin(pose, up, -pitch);
  const turn = quatMul(axisAngle(up, yaw), axisAngle(axis(pose, 0), -within));
  return turnAbout(pose, pivot, turn);
}

/** Towards the pivot: the distance times `factor`. */
export function nearer(pose: Pose, pivot: Vec3, factor: number): Pose {
  return { ...pose, position: add(pivot, scale(sub(pose.position, pivot), factor)) };
}

/** Right and down in the plane of the image, world units. */
export function shift(pose: Pose, right: number, down: number): Vec3 {
  return add(scale(axis(pose, 0), right), scale(axis(pose, 1), down));
}
