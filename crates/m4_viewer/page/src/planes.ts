/** Planes of bytes: one component after the other, each with one plane a byte, the least significant first. */

import { PageError } from "./errors";

export function damaged(what: string, cause?: unknown): PageError {
  return new PageError(
    "The scene in this page is damaged",
    `The splats cannot be read: ${what}. Export the page again from its scene.`,
    { cause },
  );
}

export class Planes {
  constructor(
    private readonly bytes: Uint8Array,
    private at: number,
  ) {}

  /** The next component: `rows` values of `width` bytes. */
  next(width: number, rows: number): (row: number) => number {
    const { bytes, at } = this;
    this.at += width * rows;
    const byte = (plane: number, row: number): number => bytes[at + plane * rows + row] as number;
    switch (width) {
      case 1:
        return (row) => byte(0, row);
      case 2:
        return (row) => byte(0, row) | (byte(1, row) << 8);
      case 3:
        return (row) => byte(0, row) | (byte(1, row) << 8) | (byte(2, row) << 16);
      default:
        return (row) =>
          (byte(0, row) | (byte(1, row) << 8) | (byte(2, row) << 16) | (byte(3, row) << 24)) >>> 0;
    }
  }

  /** The next `count` 32-bit floats. */
  floats(count: number): Float32Array {
    const view = new DataView(this.bytes.buffer, this.bytes.byteOffset + this.at, 4 * count);
    this.at += 4 * count;
    return Float32Array.from({ length: count }, (_, i) => view.getFloat32(4 * i, true));
  }

  get end(): number {
    return this.at;
  }
}
