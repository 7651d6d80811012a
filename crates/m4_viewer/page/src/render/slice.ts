/**
 * Which splats an instant shows, and in which order: the farthest first.
 *
 * Free splats lie in groups of like lifetimes (each at most twice the shortest of its group), each ordered
 * by time, so that what can be active at an instant is one range a group. The cost of an instant follows from
 * that range and from the static splats, not from the length of the clip. Bound splats lie in the order of their windows, of
 * which those about the instant are looked at.
 */

import type { BoundData, SceneData } from "../scene";
import { ROW } from "./columns";
import { LEAST_PRESENCE, Nodes, presence } from "./pose";
import { KeySort, keysOf } from "./sort";
import { REACH_SDS, marginal } from "./window";

/** What decides range and order. */
export interface SliceView {
  /** Frames. */
  readonly t: number;
  /** World to camera, OpenCV axes, 3x4 row-major. */
  readonly w2c: readonly number[];
  readonly fx: number;
  readonly fy: number;
  readonly cx: number;
  readonly cy: number;
  readonly width: number;
  readonly height: number;
  /** The part of the image that is shown, pixels: left, top, right, bottom. */
  readonly part: readonly [number, number, number, number];
  /** Added to the image covariance, pixels squared. */
  readonly lowPass: number;
}

/** What is shown, and how long it took. */
export interface Slice {
  /** Rows of the scene, the farthest first; filled up with [NOTHING] to whole rows of a texture. */
  readonly ids: Uint32Array;
  /** How many there are. */
  readonly count: number;
  /** The nodes that carry bound splats, for their texture. */
  readonly nodes: Float32Array<ArrayBuffer>;
  /** Bound and free splats that were considered. */
  readonly considered: number;
  readonly sliceMs: number;
  readonly sortMs: number;
}

/** No splat. */
export const NOTHING = 0xffffffff;
const ALPHA_MIN = 1 / 255;
const NEAR_MIN = 1e-6;
/** The shaders work with single precision: what is near a limit is theirs to decide. */
const SLACK = 1e-3;
/** The Jacobian is evaluated within this multiple of the half field of view (as in the shaders). */
export const JACOBIAN_MARGIN = 0.3;

/** Splats whose lifetimes are alike: rows `from..to` of the columns of free splats. */
interface Group {
  readonly from: number;
  readonly to: number;
  /** The longest reach in it, frames. */
  readonly reach: number;
}

/** How far from its middle a splat of this opacity can be seen, standard deviations. */
const extentSds = (opacity: number): number => (opacity > ALPHA_MIN ? Math.sqrt(2 * Math.log(255 * opacity)) : 0);

/** Columns for slicing; static splats first, bound ones by window, free ones by group and time. */
export class Slicer {
  private readonly nStatic: number;
  /** The first free splat. */
  private readonly freeFrom: number;
  private readonly bound: BoundData;
  readonly nodes: Nodes;
  private readonly ids: Uint32Array;
  private readonly mean: Float32Array;
  private readonly opacity: Float32Array;
  /** How far a splat reaches from its middle, world units. */
  private readonly radius: Float32Array;
  private readonly timeMean: Float32Array;
  private readonly timeSd: Float32Array;
  private readonly velocity: Float32Array;
  private readonly groups: Group[] = [];
  private readonly sorter = new KeySort();
  private readonly keys: Uint32Array;
  private readonly found: Uint32Array;

  constructor(
    data: SceneData,
    private readonly near: number,
    private readonly now: () => number = () => performance.now(),
  ) {
    const { nStatic, nBound, nFree } = data;
    const freeFrom = nStatic + nBound;
    const n = freeFrom + nFree;
    this.nStatic = nStatic;
    this.freeFrom = freeFrom;
    this.bound = data.bound;
    this.nodes = new Nodes(data.bound);
    this.ids = new Uint32Array(n);
    for (let i = 0; i < freeFrom; i++) this.ids[i] = i;
    this.ids.set(this.byGroupAndTime(data), freeFrom);

    const { ids } = this;
    const column = (from: Float32Array, width: number, first: number): Float32Array => {
      const out = new Float32Array(width * (n - first));
      for (let i = first; i < n; i++) {
        const row = (ids[i] as number) - first;
        for (let k = 0; k < width; k++) out[width * (i - first) + k] = from[width * row + k] as number;
      }
      return out;
    };
    this.mean = column(data.mean, 3, 0);
    this.opacity = column(data.opacity, 1, 0);
    this.timeMean = column(data.timeMean, 1, freeFrom);
    this.timeSd = column(data.timeSd, 1, freeFrom);
    this.velocity = column(data.velocity, 3, freeFrom);
    this.radius = new Float32Array(n);
    for (let i = 0; i < n; i++) {
      const row = 3 * (ids[i] as number);
      const sd = Math.max(data.scale[row] as number, data.scale[row + 1] as number, data.scale[row + 2] as number);
      this.radius[i] = sd * extentSds(this.opacity[i] as number);
    }
    this.keys = new Uint32Array(n);
    this.found = new Uint32Array(n);
  }

  /** Rows of free splats by group, then time; fills `groups`. */
  private byGroupAndTime({ nStatic, nBound, nFree, timeMean, timeSd }: SceneData): Uint32Array {
    const freeFrom = nStatic + nBound;
    const rows = new Uint32Array(nFree);
    for (let d = 0; d < nFree; d++) rows[d] = freeFrom + d;
    this.sorter.sort(keysOf(timeMean), rows, nFree);
    // the exponent of the lifetime; sorting is stable, so that the order by time remains
    const exponents = new Uint32Array(nFree);
    for (let i = 0; i < nFree; i++) {
      const sd = timeSd[(rows[i] as number) - freeFrom] as number;
      exponents[i] = sd > 0 && sd < Infinity ? 256 + Math.floor(Math.log2(sd)) : sd > 0 ? 1024 : 0;
    }
    this.sorter.sort(exponents, rows, nFree);
    for (let from = 0; from < nFree; ) {
      let to = from;
      let longest = 0;
      for (; to < nFree && exponents[to] === exponents[from]; to++) {
        longest = Math.max(longest, timeSd[(rows[to] as number) - freeFrom] as number);
      }
      this.groups.push({ from, to, reach: longest * REACH_SDS * (1 + SLACK) });
      from = to;
    }
    return rows;
  }

  /** The first free row of a group at or after a time. */
  private first({ from, to }: Group, t: number): number {
    let [low, high] = [from, to];
    while (low < high) {
      const middle = (low + high) >> 1;
      if ((this.timeMean[middle] as number) < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** Hands over the bound splats that are there at `t`, where nodes carry them; how many were looked at. */
  private carried(t: number, take: (i: number, x: number, y: number, z: number) => void): number {
    const { bound, nodes, mean, opacity, nStatic } = this;
    const { birth, velocity, life } = bound;
    const place = new Float64Array(3);
    let looked = 0;
    for (const { window, half, first } of nodes.at(t)) {
      for (let b = window.from; b < window.to; b++) {
        looked += 1;
        const share = presence(t, life[2 * b] as number, life[2 * b + 1] as number, half);
        if (share < LEAST_PRESENCE * (1 - SLACK)) continue;
        const i = nStatic + b;
        const own = opacity[i] as number;
        if ((share < 1 ? 1 - (1 - own) ** share : own) < ALPHA_MIN * (1 - SLACK)) continue;
        const dt = t - (birth[b] as number);
        const x = (mean[3 * i] as number) + dt * (velocity[3 * b] as number);
        const y = (mean[3 * i + 1] as number) + dt * (velocity[3 * b + 1] as number);
        const z = (mean[3 * i + 2] as number) + dt * (velocity[3 * b + 2] as number);
        nodes.carry(first, bound, b, x, y, z, place);
        take(i, place[0] as number, place[1] as number, place[2] as number);
      }
    }
    return looked;
  }

  slice(view: SliceView): Slice {
    const started = this.now();
    const { mean, opacity, radius, timeMean, timeSd, velocity, ids, keys, found, nStatic, freeFrom } = this;
    const { t, fx, fy, cx, cy, width, height, part, lowPass } = view;
    const m = (i: number): number => view.w2c[i] ?? 0;
    const [a0, a1, a2, a3] = [m(0), m(1), m(2), m(3)];
    const [b0, b1, b2, b3] = [m(4), m(5), m(6), m(7)];
    const [c0, c1, c2, c3] = [m(8), m(9), m(10), m(11)];
    const near = Math.max(this.near, NEAR_MIN) * (1 - SLACK);
    // the shape of a splat is at most its radius, seen through the steepest Jacobian, and the
    // low-pass
    const [marginX, marginY] = [(JACOBIAN_MARGIN * width) / (2 * fx), (JACOBIAN_MARGIN * height) / (2 * fy)];
    const steepX = Math.max(cx / fx, (width - cx) / fx) + marginX;
    const steepY = Math.max(cy / fy, (height - cy) / fy) + marginY;
    const growX = fx * Math.hypot(1, steepX) * (1 + SLACK);
    const growY = fy * Math.hypot(1, steepY) * (1 + SLACK);
    const soft = extentSds(1) * Math.sqrt(lowPass) + 1;
    const [left, top, right, bottom] = part;
    const [midX, midY] = [(left + right) / 2 - cx, (top + bottom) / 2 - cy];
    const [halfX, halfY] = [(right - left) / 2 + soft, (bottom - top) / 2 + soft];
    const depth = new Float32Array(1);
    const bits = new Uint32Array(depth.buffer);

    let count = 0;
    const consider = (i: number, x: number, y: number, z: number): void => {
      const forward = c0 * x + c1 * y + c2 * z + c3;
      if (!(forward > near)) return;
      const r = radius[i] as number;
      const across = fx * (a0 * x + a1 * y + a2 * z + a3) - midX * forward;
      if (Math.abs(across) > halfX * forward + growX * r) return;
      const down = fy * (b0 * x + b1 * y + b2 * z + b3) - midY * forward;
      if (Math.abs(down) > halfY * forward + growY * r) return;
      depth[0] = forward;
      // positive numbers rise with their bits; the farthest comes first
      keys[count] = ~(bits[0] as number);
      found[count] = ids[i] as number;
      count += 1;
    };

    for (let i = 0; i < nStatic; i++) {
      consider(i, mean[3 * i] as number, mean[3 * i + 1] as number, mean[3 * i + 2] as number);
    }
    let considered = this.carried(t, consider);
    for (const group of this.groups) {
      const to = this.first(group, t + group.reach);
      for (let d = this.first(group, t - group.reach); d < to; d++) {
        considered += 1;
        const dt = t - (timeMean[d] as number);
        const sd = timeSd[d] as number;
        if (!(Math.abs(dt) <= sd * REACH_SDS * (1 + SLACK))) continue;
        const i = freeFrom + d;
        if ((opacity[i] as number) * marginal(dt, sd) < ALPHA_MIN * (1 - SLACK)) continue;
        consider(
          i,
          (mean[3 * i] as number) + dt * (velocity[3 * d] as number),
          (mean[3 * i + 1] as number) + dt * (velocity[3 * d + 1] as number),
          (mean[3 * i + 2] as number) + dt * (velocity[3 * d + 2] as number),
        );
      }
    }
    const sliced = this.now();
    this.sorter.sort(keys, found, count);
    const out = new Uint32Array(ROW * Math.ceil(count / ROW));
    out.set(found.subarray(0, count));
    out.fill(NOTHING, count);
    return { ids: out, count, nodes: this.nodes.texels.slice(), considered, sliceMs: sliced - started, sortMs: this.now() - sliced };
  }
}
