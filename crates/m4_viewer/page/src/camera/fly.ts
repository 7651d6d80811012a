/** Flying: keys push along the camera's axes, speed builds up and dies away. */

import { type Pose, type Vec3, add, axis, norm, scale } from "../maths";

/** Seconds after which a push has had two thirds of its effect. */
const RESPONSE_S = 0.12;
const FAST = 3;

export interface Push {
  readonly right: number;
  readonly up: number;
  readonly ahead: number;
  readonly fast: boolean;
}

const KEYS: Readonly<Record<string, readonly [keyof Omit<Push, "fast">, number]>> = {
  KeyW: ["ahead", 1],
  ArrowUp: ["ahead", 1],
  KeyS: ["ahead", -1],
  ArrowDown: ["ahead", -1],
  KeyD: ["right", 1],
  ArrowRight: ["right", 1],
  KeyA: ["right", -1],
  ArrowLeft: ["right", -1],
  KeyE: ["up", 1],
  KeyQ: ["up", -1],
};

/** Whether a key (`KeyboardEvent.code`) flies. */
export const flies = (code: string): boolean => code in KEYS;

/** What the keys that are down push towards. */
export function pushOf(down: ReadonlySet<string>): Push {
  const sum = { right: 0, up: 0, ahead: 0 };
  for (const code of down) {
    const key = KEYS[code];
    if (key) sum[key[0]] += key[1];
  }
  return {
    right: Math.sign(sum.right),
    up: Math.sign(sum.up),
    ahead: Math.sign(sum.ahead),
    fast: down.has("ShiftLeft") || down.has("ShiftRight"),
  };
}

/** Velocity after `seconds` more of a push; `reach` is the speed that it ends at, world units a second. */
export function fliedVelocity(velocity: Vec3, pose: Pose, up: Vec3, push: Push, reach: number, seconds: number): Vec3 {
  const direction = add(
    add(scale(axis(pose, 0), push.right), scale(axis(pose, 2), push.ahead)),
    scale(up, push.up),
  );
  const length = norm(direction);
  const wanted = length > 0 ? scale(direction, (reach * (push.fast ? FAST : 1)) / length) : ([0, 0, 0] as const);
  const share = 1 - Math.exp(-seconds / RESPONSE_S);
  return add(scale(velocity, 1 - share), scale(wanted, share));
}
