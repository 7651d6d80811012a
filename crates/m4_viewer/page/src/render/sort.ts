/** Sorting by depth, without comparisons. */

const DIGIT_BITS = 11;
const DIGITS = 1 << DIGIT_BITS;
const PASSES = 3;

/** Puts `ids` in the order of 32-bit keys, the smallest first; equal keys keep their order. Memory is kept between calls. */
export class KeySort {
  private keys: Uint32Array = new Uint32Array(0);
  private ids: Uint32Array = new Uint32Array(0);
  private readonly counts = new Uint32Array(PASSES * DIGITS);

  /** Sorts the first `n` of both arrays by `keys`. */
  sort(keys: Uint32Array, ids: Uint32Array, n: number): void {
    if (this.keys.length < n) {
      this.keys = new Uint32Array(keys.length);
      this.ids = new Uint32Array(keys.length);
    }
    const { counts } = this;
    counts.fill(0);
    for (let i = 0; i < n; i++) {
      const key = keys[i] as number;
      for (let pass = 0; pass < PASSES; pass++) {
        const digit = pass * DIGITS + ((key >>> (pass * DIGIT_BITS)) & (DIGITS - 1));
        counts[digit] = (counts[digit] as number) + 1;
      }
    }
    let [fromKeys, fromIds, toKeys, toIds] = [keys, ids, this.keys, this.ids];
    for (let pass = 0; pass < PASSES; pass++) {
      let at = 0;
      for (let digit = pass * DIGITS; digit < (pass + 1) * DIGITS; digit++) {
        const count = counts[digit] as number;
        counts[digit] = at;
        at += count;
      }
      const shift = pass * DIGIT_BITS;
      for (let i = 0; i < n; i++) {
        const key = fromKeys[i] as number;
        const digit = pass * DIGITS + ((key >>> shift) & (DIGITS - 1));
        const to = counts[digit] as number;
        counts[digit] = to + 1;
        toKeys[to] = key;
        toIds[to] = fromIds[i] as number;
      }
      [fromKeys, fromIds, toKeys, toIds] = [toKeys, toIds, fromKeys, fromIds];
    }
    // an odd number of passes ends in the other arrays
    keys.set(fromKeys.subarray(0, n));
    ids.set(fromIds.subarray(0, n));
  }
}

/** A key that rises with a number, for numbers of either sign. */
export function keysOf(values: Float32Array): Uint32Array {
  const bits = new Uint32Array(values.buffer, values.byteOffset, values.length);
  return bits.map((b) => (b & 0x80000000 ? ~b : b | 0x80000000) >>> 0);
}
