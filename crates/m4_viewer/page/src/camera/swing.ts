/** Bullet time: while time is paused the camera swings gently about what it looks at. */

import { type Pose, type Vec3, distance, smoothstep } from "../maths";
import { turned } from "./orbit";

/** Seconds a full swing takes. */
const PERIOD_S = 7;
/** Seconds in which the swing builds up. */
const START_S = 1.2;
/** Widest turn to a side, radians. */
const SIDE_MOST = 0.45;
/** Up and down, as a share of the sideways turn; twice as fast. */
const UP_SHARE = 0.22;
/** Share of the safe radius that the swing uses. */
export const REACH = 0.85;

/** The widest sideways turn that stays in the safe region, radians. */
export function swingAngle(pose: Pose, pivot: Vec3, safeRadius: number): number {
  const arm = distance(pose.position, pivot);
  if (!(arm > 0)) return 0;
  // a turn by an angle moves the camera along a chord of 2 arm sin(angle / 2)
  const half = Math.min((REACH * safeRadius) / (2 * arm * Math.hypot(1, UP_SHARE)), 1);
  return Math.min(2 * Math.asin(half), SIDE_MOST);
}

/** The pose `seconds` after the swing began at `base`. */
export function swung(base: Pose, pivot: Vec3, up: Vec3, angle: number, seconds: number): Pose {
  const phase = (2 * Math.PI * seconds) / PERIOD_S;
  const reach = angle * smoothstep(0, START_S, seconds);
  return turned(base, pivot, up, reach * Math.sin(phase), UP_SHARE * reach * Math.sin(2 * phase));
}
