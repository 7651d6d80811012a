import { gzipSync } from "node:zlib";
import { expect, test } from "vitest";
import { fromBase64, gunzip, isGzip } from "../src/bytes";
import { PageError } from "../src/errors";

const bytes = Uint8Array.from({ length: 1_000_001 }, (_, i) => (i * 7919) >> 3);

test("base64 of any length comes back, with progress to the end", async () => {
  for (const length of [0, 1, 2, 3, 4, 1_000_001]) {
    const seen: number[] = [];
    const part = bytes.slice(0, length);
    const back = await fromBase64(Buffer.from(part).toString("base64"), "splats", (s) => seen.push(s));
    expect(Buffer.compare(back, part)).toBe(0);
    if (length > 0) expect(seen.at(-1)).toBe(1);
  }
});

test("line breaks do no harm", async () => {
  expect([...(await fromBase64(" AQID\nBAU= \n", "splats"))]).toEqual([1, 2, 3, 4, 5]);
});

test("what is no base64 says what it was", async () => {
  await expect(fromBase64("A%BC", "input frames")).rejects.toThrow("input frames");
  await expect(fromBase64("AAAAA", "splats")).rejects.toThrow(PageError);
});

test("gzip comes back, and damaged gzip says so", async () => {
  const packed = new Uint8Array(gzipSync(bytes));
  expect(isGzip(packed)).toBe(true);
  expect(Buffer.compare(await gunzip(packed, "splats"), bytes)).toBe(0);
  await expect(gunzip(packed.slice(0, 1000), "splats")).rejects.toThrow(PageError);
  const flipped = packed.slice();
  flipped[flipped.length - 6] = (flipped[flipped.length - 6] ?? 0) ^ 1;
  await expect(gunzip(flipped, "splats")).rejects.toThrow("splats");
});
