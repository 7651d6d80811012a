/**
 * How far the camera may leave the filmed path.
 *
 * Within `radius` of it everything was seen by the source camera from nearly there. Further out the
 * image fades; at `STOP_AT` times the radius the camera stops.
 */

import { type Vec3, add, distance, norm, scale, smoothstep, sub } from "../maths";
import type { SourcePath } from "./path";

const STOP_AT = 1.6;
/** How much of the image has faded where the camera stops. */
const FADE_MOST = 0.8;
/** Share of the distance to what is looked at that takes the place of a radius of nothing. */
const LEAST_SHARE = 0.05;

export class SafeRegion {
  readonly radius: number;
  readonly stop: number;

  constructor(
    private readonly path: SourcePath,
    radius: number,
    centre: Vec3,
  ) {
    const reach = distance(path.nearest(centre).point, centre);
    this.radius = radius > 0 ? radius : Math.max(LEAST_SHARE * reach, 1e-3);
    this.stop = STOP_AT * this.radius;
  }

  /** 0 in the safe region, rising to `FADE_MOST` where the camera stops. */
  fade(place: Vec3): number {
    return FADE_MOST * smoothstep(this.radius, this.stop, this.path.nearest(place).distance);
  }

  /** Whether a camera may go from one place to another: inside, or at least back towards it. */
  allows(from: Vec3, to: Vec3): boolean {
    const far = this.path.nearest(to).distance;
    return far <= this.stop || far < this.path.nearest(from).distance;
  }

  /** `place`, or the nearest place at which a camera may be. */
  hold(place: Vec3): Vec3 {
    const { point, distance: far } = this.path.nearest(place);
    if (far <= this.stop) return place;
    const out = sub(place, point);
    return add(point, scale(out, this.stop / norm(out)));
  }

  /** The largest share of a way from 0 to 1 after which the camera is still where it may be. */
  furthest(from: Vec3, way: (share: number) => Vec3): number {
    if (this.allows(from, way(1))) return 1;
    let [inside, outside] = [0, 1];
    for (let i = 0; i < 16; i++) {
      const middle = (inside + outside) / 2;
      if (this.allows(from, way(middle))) inside = middle;
      else outside = middle;
    }
    return inside;
  }
}
