/** Frames of the source clip, decoded when they are needed. */

import type { FrameIndex } from "./scene";

/** Decoded frames that are kept. */
const KEEP = 16;

export class SourceFrames {
  private readonly kept = new Map<number, Promise<ImageBitmap>>();

  constructor(
    readonly index: FrameIndex,
    private readonly bytes: Uint8Array<ArrayBuffer>,
  ) {}

  get count(): number {
    return this.index.offsets.length - 1;
  }

  /** Frame `i`; rejects where it is not an image. */
  frame(i: number): Promise<ImageBitmap> {
    const known = this.kept.get(i);
    if (known) {
      // the newest at the end
      this.kept.delete(i);
      this.kept.set(i, known);
      return known;
    }
    const [from, to] = [this.index.offsets[i] ?? 0, this.index.offsets[i + 1] ?? 0];
    const picture = createImageBitmap(new Blob([this.bytes.slice(from, to)], { type: "image/jpeg" }));
    this.kept.set(i, picture);
    if (this.kept.size > KEEP) {
      const oldest = this.kept.keys().next().value;
      if (oldest !== undefined) {
        void this.kept.get(oldest)?.then((b) => b.close(), () => undefined);
        this.kept.delete(oldest);
      }
    }
    return picture;
  }
}
