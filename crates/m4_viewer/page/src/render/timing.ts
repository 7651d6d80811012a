/** What the last instants cost. */

/** Instants that medians and the rate are taken of. */
const KEEP = 12;
/** Instants that are further apart did not follow one another, milliseconds. */
const APART_MS = 10_000;

/** Milliseconds of one instant. */
export interface InstantCost {
  /** Choosing the splats that can be seen at the instant, with their depths (worker). */
  readonly slice: number;
  /** The order from the worker into graphics memory; nothing is read back from there. */
  readonly readback: number;
  /** Sorting them by depth (worker). */
  readonly sort: number;
  /** From the first command of drawing until the graphics driver has done all of them. */
  readonly draw: number;
}

export class Timing {
  private readonly costs: InstantCost[] = [];
  private readonly shown: number[] = [];

  /** An instant that was drawn, at `now`, milliseconds. */
  push(cost: InstantCost, now: number): void {
    this.costs.push(cost);
    if (this.costs.length > KEEP) this.costs.shift();
    this.shown.push(now);
    if (this.shown.length > KEEP) this.shown.shift();
  }

  /** The median of each part over the last instants. */
  get cost(): InstantCost {
    const median = (part: keyof InstantCost): number =>
      this.costs.map((c) => c[part]).toSorted((a, b) => a - b)[this.costs.length >> 1] ?? 0;
    return { slice: median("slice"), readback: median("readback"), sort: median("sort"), draw: median("draw") };
  }

  /** Instants drawn so far, at most as many as a median is taken of. */
  get count(): number {
    return this.costs.length;
  }

  /** Forgets the costs, not the rate: what comes is of another size. */
  restart(): void {
    this.costs.length = 0;
  }

  /** Instants a second. */
  rate(now: number): number {
    const apart = this.shown.map((t, i) => (this.shown[i + 1] ?? now) - t);
    // from the last pause on, and not after a new one
    const from = apart.findLastIndex((ms) => ms > APART_MS) + 1;
    const first = this.shown[from];
    const last = this.shown.at(-1);
    if (first === undefined || last === undefined || last <= first) return 0;
    return (1000 * (this.shown.length - 1 - from)) / (last - first);
  }
}
