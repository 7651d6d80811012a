/**
 * How far the camera may leave the filmed path.
 *
 * Within `radius` of it everything was seen by the source camera from nearly there. What moves was seen at one instant by
 * one camera: where its distance is doubtful the camera also stays near the source camera of that instant. Further out
 * the image fades; at `STOP_AT` times either distance the camera stops.
 */

import { type Vec3, add, distance, mix, scale, smoothstep, sub } from "../maths";
import { type DistanceLimit, LEAST_SHARE } from "./limit";
import type { SourcePath } from "./path";

const STOP_AT = 1.6;
/** How much of the image has faded where the camera stops. */
const FADE_MOST = 0.8;
/** Share of the limit of moving parts from which on the page shows the hint: a camera at rest on it is. */
const TOLD_AT = 0.95;

export class SafeRegion {
  /** From the path, world units. */
  readonly radius: number;
  /** The user wants to turn further than moving parts are placed for. */
  lifted = false;

  constructor(
    private readonly path: SourcePath,
    radius: number,
    centre: Vec3,
    /** From the source camera of the moment. */
    readonly limit: DistanceLimit | null = null,
  ) {
    const reach = distance(path.nearest(centre).point, centre);
    this.radius = radius > 0 ? radius : Math.max(LEAST_SHARE * reach, 1e-3);
  }

  /** The distance from the source camera that moving parts allow, world units. */
  limitAt(t: number): number {
    return this.limit && !this.lifted ? this.limit.at(t) : Infinity;
  }

  /** How far the camera may leave the source camera of the moment without a fade, world units. */
  radiusAt(t: number): number {
    return Math.min(this.radius, this.limitAt(t));
  }

  /** And until it stops. */
  stopAt(t: number): number {
    return STOP_AT * this.radiusAt(t);
  }

  private fromSource(place: Vec3, t: number): number {
    return distance(place, this.path.pose(t).position) / this.limitAt(t);
  }

  /** How far out a place is: up to 1 in the safe region, `STOP_AT` where the camera stops. */
  private out(place: Vec3, t: number | null): number {
    const fromPath = this.path.nearest(place).distance / this.radius;
    return t === null ? fromPath : Math.max(fromPath, this.fromSource(place, t));
  }

  /**
   * 0 in the safe region, rising to `FADE_MOST` where the camera stops. `t` is the time that is shown, `null` where
   * moving parts do not count.
   */
  fade(place: Vec3, t: number | null): number {
    return FADE_MOST * smoothstep(1, STOP_AT, this.out(place, t));
  }

  /** Why the image of a camera is about to fade, if moving parts are the reason. */
  caution(place: Vec3, t: number): string | null {
    const out = this.fromSource(place, t);
    return this.limit && out > TOLD_AT && out >= this.out(place, null) ? this.limit.words(t) : null;
  }

  /** Whether a camera may go from one place to another: inside, or at least back towards it. */
  allows(from: Vec3, to: Vec3, t: number): boolean {
    const out = this.out(to, t);
    return out <= STOP_AT || out < this.out(from, t);
  }

  /** `to`, or the nearest place at which a camera that comes from `from` may be: no further out than that. */
  hold(from: Vec3, to: Vec3, t: number): Vec3 {
    const most = Math.max(STOP_AT, this.out(from, t));
    const { point, distance: far } = this.path.nearest(to);
    const share = (most * this.radius) / far;
    const near = share < 1 ? add(point, scale(sub(to, point), share)) : to;
    const back = most / this.fromSource(near, t);
    return back < 1 ? mix(this.path.pose(t).position, near, back) : near;
  }

  /** The largest share of a way from 0 to 1 after which the camera is still where it may be. */
  furthest(from: Vec3, way: (share: number) => Vec3, t: number): number {
    if (this.allows(from, way(1), t)) return 1;
    let [inside, outside] = [0, 1];
    for (let i = 0; i < 16; i++) {
      const middle = (inside + outside) / 2;
      if (this.allows(from, way(middle), t)) inside = middle;
      else outside = middle;
    }
    return inside;
  }
}
