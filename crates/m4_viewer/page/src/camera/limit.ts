/**
 * How far the camera may be from the source camera of the moment before errors of distances show.
 *
 * One camera knows the distance of moving parts with a relative standard deviation `s` only. From `b` beside that camera,
 * things `z` away are then out of place by `f b s / z` pixels of the source image.
 */

import type { Vec3 } from "../maths";
import type { SourceCamera } from "../scene";
import type { SourcePath } from "./path";

/** Displacement by one standard deviation that is not exceeded, pixels of the source image. */
const MOST_PX = 3;
/**
 * Share of the distance to what is looked at by which a camera may move in any scene: a turn by 3 degrees. With less the
 * image would not seem to move at all.
 */
export const LEAST_SHARE = 0.05;
/** The limit widens and narrows by no more than this share of that distance, a second. */
const RATE_SHARE = 0.2;

/** The limit at each source camera. */
interface Stop {
  /** World units. */
  readonly reach: number;
  /** The deviation it comes from; of a neighbour in time where that is the narrower one. */
  readonly sigma: number;
}

export class DistanceLimit {
  private readonly reaches: readonly number[];

  private constructor(
    private readonly path: SourcePath,
    private readonly stops: readonly Stop[],
    private readonly depth: number,
  ) {
    this.reaches = stops.map((stop) => stop.reach);
  }

  /** The limit of a scene; none where no distance has a deviation. */
  static of(path: SourcePath, cameras: readonly SourceCamera[], centre: Vec3, fps: number): DistanceLimit | null {
    if (cameras.every((c) => c.distance_sigma === undefined)) return null;
    const depth = path.depth(centre);
    if (!(depth > 0)) return null;
    const stops = cameras.map(({ fx, distance_sigma: sigma = 0 }) => ({
      reach: Math.max((MOST_PX * depth) / (fx * sigma), LEAST_SHARE * depth),
      sigma,
    }));
    // forth and back: an object that appears is prepared for
    const rate = (RATE_SHARE * depth) / fps;
    const steps = cameras.map((c, i) => rate * (c.t - (cameras[i - 1]?.t ?? c.t)));
    for (let i = 1; i < stops.length; i++) narrow(stops, i, i - 1, steps[i] ?? 0);
    for (let i = stops.length - 2; i >= 0; i--) narrow(stops, i, i + 1, steps[i + 1] ?? 0);
    return new DistanceLimit(path, stops, depth);
  }

  /** The distance from the source camera at a time, world units. */
  at(t: number): number {
    return this.path.between(t, this.reaches);
  }

  /** Why the camera is limited at a time, for the user. */
  words(t: number): string {
    const sigma = this.stops[this.path.nearestIndex(t)]?.sigma ?? 0;
    const turn = 2 * Math.asin(Math.min(this.at(t) / (2 * this.depth), 1));
    const [percent, degrees] = [100 * sigma, (turn * 180) / Math.PI].map((v) => Math.max(Math.round(v), 1));
    return `Moving parts are placed to ±${percent}\u00a0%: the image fades beyond ${degrees}°`;
  }
}

/** Keeps stop `i` within a step of its neighbour. */
function narrow(stops: Stop[], i: number, neighbour: number, step: number): void {
  const [here, next] = [stops[i], stops[neighbour]];
  if (here && next && next.reach + step < here.reach) stops[i] = { reach: next.reach + step, sigma: next.sigma };
}
