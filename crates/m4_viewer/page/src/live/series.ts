/** A value over the iterations, as a line of bounded length. */

export interface Point {
  readonly x: number;
  readonly y: number;
}

/** Points that are kept; when there are more, every second of the older ones goes. */
const MOST = 512;

export class Series {
  private kept: Point[] = [];
  /** Only every so-many-th point is taken. */
  private stride = 1;
  private seen = 0;
  private newest: Point | null = null;

  push(x: number, y: number): void {
    if (!Number.isFinite(x) || !Number.isFinite(y)) return;
    // a run that begins again writes over what came after
    if (this.newest && x < this.newest.x) this.kept = this.kept.filter((p) => p.x < x);
    this.newest = { x, y };
    if (this.seen++ % this.stride !== 0) return;
    this.kept.push(this.newest);
    if (this.kept.length > MOST) {
      this.kept = this.kept.filter((_, i) => i % 2 === 0);
      this.stride *= 2;
    }
  }

  get last(): Point | null {
    return this.newest;
  }

  /** All points, the newest at the end. */
  get points(): readonly Point[] {
    const end = this.kept.at(-1);
    return this.newest && end !== this.newest ? [...this.kept, this.newest] : this.kept;
  }
}

/** `M x,y L ..` in a box of `width x height`, larger values higher; empty without two points. */
export function linePath(points: readonly Point[], width: number, height: number): string {
  const [first, last] = [points[0], points.at(-1)];
  if (points.length < 2 || !first || !last) return "";
  let [low, high] = [Infinity, -Infinity];
  for (const p of points) [low, high] = [Math.min(low, p.y), Math.max(high, p.y)];
  const [spanX, spanY] = [last.x - first.x || 1, high - low];
  return points
    .map((p, i) => {
      const x = (width * (p.x - first.x)) / spanX;
      // a value that never changed is a line in the middle
      const y = spanY > 0 ? height * (1 - (p.y - low) / spanY) : height / 2;
      return `${i === 0 ? "M" : "L"}${x.toFixed(2)},${y.toFixed(2)}`;
    })
    .join("");
}
