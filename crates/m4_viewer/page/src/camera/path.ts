/** The way of the source camera: where it was at any time, and how far a place is from it. */

import {
  type Pose,
  type Vec3,
  add,
  axis,
  clamp,
  distance,
  dot,
  mix,
  mixPose,
  poseOf,
  scale,
  sub,
  unit,
} from "../maths";
import type { SourceCamera } from "../scene";

/** Pinhole intrinsics, pixels of an image of this size. */
export interface Lens {
  readonly fx: number;
  readonly fy: number;
  readonly cx: number;
  readonly cy: number;
  readonly width: number;
  readonly height: number;
}

interface Stop {
  readonly t: number;
  readonly pose: Pose;
  readonly lens: Lens;
}

/** Where a scene without source cameras is looked at from: the origin, along z. */
const NOWHERE: Stop = {
  t: 0,
  pose: { rotation: [1, 0, 0, 0], position: [0, 0, 0] },
  lens: { fx: 600, fy: 600, cx: 320, cy: 180, width: 640, height: 360 },
};

export class SourcePath {
  private readonly stops: readonly Stop[];
  /** Against gravity, as far as the cameras tell: the mean of their upward axes. */
  readonly up: Vec3;

  constructor(cameras: readonly SourceCamera[]) {
    const stops = cameras.map((c) => ({
      t: c.t,
      pose: poseOf(c.c2w),
      lens: { fx: c.fx, fy: c.fy, cx: c.cx, cy: c.cy, width: c.width, height: c.height },
    }));
    this.stops = stops.length > 0 ? stops : [NOWHERE];
    const down = this.stops.reduce<Vec3>((sum, s) => add(sum, axis(s.pose, 1)), [0, 0, 0]);
    this.up = unit(scale(down, -1), [0, -1, 0]);
  }

  /** How far the middle of the scene is from the camera that looks at it, the middle one. */
  depth(centre: Vec3): number {
    return distance(this.stop(this.stops.length >> 1).pose.position, centre);
  }

  /** The last stop at or before `t`, and how far `t` is on the way to the next, 0..1. */
  private place(t: number): { index: number; share: number } {
    let [low, high] = [0, this.stops.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.stop(middle).t <= t) low = middle;
      else high = middle - 1;
    }
    const here = this.stop(low);
    const next = this.stops[low + 1];
    const share = next && next.t > here.t ? clamp((t - here.t) / (next.t - here.t), 0, 1) : 0;
    return { index: low, share };
  }

  private stop(index: number): Stop {
    return this.stops[clamp(index, 0, this.stops.length - 1)] ?? NOWHERE;
  }

  /** The pose at a time, between the cameras next to it. */
  pose(t: number): Pose {
    const { index, share } = this.place(t);
    const here = this.stop(index).pose;
    return share > 0 ? mixPose(here, this.stop(index + 1).pose, share) : here;
  }

  /** The lens at a time. */
  lens(t: number): Lens {
    const { index, share } = this.place(t);
    const here = this.stop(index).lens;
    const next = this.stop(index + 1).lens;
    const between = (a: number, b: number): number => a + (b - a) * share;
    if (share === 0 || next.width !== here.width || next.height !== here.height) return here;
    return {
      fx: between(here.fx, next.fx),
      fy: between(here.fy, next.fy),
      cx: between(here.cx, next.cx),
      cy: between(here.cy, next.cy),
      width: here.width,
      height: here.height,
    };
  }

  /** A number at a time, of one for each camera. */
  between(t: number, values: readonly number[]): number {
    const { index, share } = this.place(t);
    const here = values[index] ?? 0;
    return share > 0 ? here + ((values[index + 1] ?? here) - here) * share : here;
  }

  /** The camera that is nearest in time. */
  nearestIndex(t: number): number {
    const { index, share } = this.place(t);
    return share > 0.5 ? Math.min(index + 1, this.stops.length - 1) : index;
  }

  /** The point of the path that is nearest in space. */
  nearest(place: Vec3): { point: Vec3; distance: number } {
    let point = this.stop(0).pose.position;
    let best = distance(place, point);
    for (let i = 1; i < this.stops.length; i++) {
      const a = this.stop(i - 1).pose.position;
      const along = sub(this.stop(i).pose.position, a);
      const length2 = dot(along, along);
      const share = length2 > 0 ? clamp(dot(sub(place, a), along) / length2, 0, 1) : 0;
      const candidate = mix(a, this.stop(i).pose.position, share);
      const far = distance(place, candidate);
      if (far < best) [best, point] = [far, candidate];
    }
    return { point, distance: best };
  }
}
