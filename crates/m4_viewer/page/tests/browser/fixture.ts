/** A small scene with everything in it: still and moving splats, colours that change with direction and time. */

import { readFileSync } from "node:fs";
import { gzipSync } from "node:zlib";
import { decodePayload } from "../../src/payload";
import type { Manifest, SceneData } from "../../src/scene";

const STATIC = 220;
const DYNAMIC = 80;
export const FRAMES = 24;
/** 32 x 18 pixels of H.264 (Baseline): red, green, blue; decoding can begin at the first and the last. */
const CODED = [
  "AAAAAWdCwArZCX4jAWoCAgKAAAADAIAAABgHiRMkAAAAAWjLg8sgAAABZYiECvEYoAAlvxwABCVjgACXhJ114A==",
  "AAAAAUGaOBXxuKAAI70cAASQY4AAlY4nz+fw",
  "AAAAAWdCwArZCX4jAWoCAgKAAAADAIAAABgHiRMkAAAAAWjLg8sgAAABZYiCAvxGKAAKXMcAATUo4AAgayddeA==",
].map((s) => Buffer.from(s, "base64"));
/** A red JPEG of 16 x 9 pixels. */
const POSTER =
  "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABALDA4MChAODQ4SERATGCgaGBYWGDEjJR0oOjM9PDkzODdASFxOQERXRTc4UG1RV19iZ2hnPk1xeXBkeFxlZ2P/2wBDARESEhgVGC8aGi9jQjhCY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2P/wAARCAAJABADASIAAhEBAxEB/8QAFQABAQAAAAAAAAAAAAAAAAAAAAX/xAAUEAEAAAAAAAAAAAAAAAAAAAAA/8QAFQEBAQAAAAAAAAAAAAAAAAAABAb/xAAUEQEAAAAAAAAAAAAAAAAAAAAA/9oADAMBAAIRAxEAPwCWAEpn/9k=";

/** Always the same numbers in 0..1. */
function numbers(seed: number): () => number {
  let state = seed;
  return () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
}

/** Planes of bytes, the least significant first, of `rows` values. */
function planes(width: number, values: readonly number[]): Buffer {
  const out = Buffer.alloc(width * values.length);
  values.forEach((v, i) => {
    for (let b = 0; b < width; b++) out[b * values.length + i] = Math.floor(v / 2 ** (8 * b)) & 255;
  });
  return out;
}

/** Splats as the program writes them: see `crates/m4_viewer/src/payload`. */
function payload(): Buffer {
  const random = numbers(7);
  const n = STATIC + DYNAMIC;
  const fill = (count: number, f: (i: number) => number): number[] => Array.from({ length: count }, (_, i) => Math.round(f(i)));
  const still = (i: number): boolean => i < STATIC;
  const header = Buffer.alloc(136);
  header.write("M4SP", 0, "latin1");
  [1, STATIC, DYNAMIC].forEach((v, i) => header.writeUInt32LE(v, 4 + 4 * i));
  header.set([1, 1, 0], 16);
  // centre of the means, their spread and step, size, colour, time, duration, velocity
  [0, 0, 4, 1, 2e-7, -6, 0.02, 1e-4, 0, (FRAMES - 1) / 65535, 0, 0.015, 0.05, 5e-5].forEach((v, i) =>
    header.writeDoubleLE(v, 24 + 8 * i),
  );
  const spread = [2.2, 1.3, 1.5];
  const parts = [
    header,
    ...spread.map((s) => planes(3, fill(n, () => 2 ** 23 + Math.asinh(s * (2 * random() - 1)) / 2e-7))),
    ...[0, 1, 2].map(() => planes(1, fill(n, (i) => (still(i) ? 150 : 130) + 50 * random()))),
    planes(4, fill(n, () => Math.floor(random() * 2 ** 32 - 1))),
    planes(1, fill(n, () => 80 + 175 * random())),
    // eight terms, three channels: the constant large, the others small
    ...Array.from({ length: 24 }, (_, k) => planes(2, fill(n, () => 2 ** 15 + (k < 3 ? 20000 : 3000) * (2 * random() - 1)))),
    planes(2, fill(DYNAMIC, () => 65535 * random())),
    planes(1, fill(DYNAMIC, () => 60 + 100 * random())),
    ...[0, 1, 2].map(() => planes(2, fill(DYNAMIC, () => 2 ** 15 + 12000 * (2 * random() - 1)))),
  ];
  return Buffer.concat(parts);
}

export interface Fixture {
  manifest: Manifest;
  data: SceneData;
  /** Without gzip. */
  bytes: Buffer;
}

export function fixture(): Fixture {
  const bytes = payload();
  const cameras = [0, 1, 2].map((i) => {
    const x = 0.3 * (i - 1);
    const [c, s] = [Math.cos(0.08 * (i - 1)), Math.sin(0.08 * (i - 1))];
    return {
      t: (i * (FRAMES - 1)) / 2,
      c2w: [c, 0, -s, x, 0, 1, 0, 0.05, s, 0, c, -0.1, 0, 0, 0, 1],
      fx: 300,
      fy: 300,
      cx: 165,
      cy: 88,
      width: 320,
      height: 180,
    };
  });
  const offsets = CODED.reduce<number[]>((all, j) => [...all, (all.at(-1) ?? 0) + j.length], [0]);
  const manifest: Manifest = {
    version: 2,
    title: "Test </script> scene",
    splats: { static: STATIC, dynamic: DYNAMIC, bound: 0, sh_degree: 1, time_degree: 1, isotropic: false, bytes: bytes.length },
    background: [0.1, 0.2, 0.3],
    time_frames: FRAMES,
    duration_s: (FRAMES - 1) / 12,
    fps: 12,
    mip: true,
    near: 0.05,
    period_frames: FRAMES - 1,
    cameras,
    centre: [0, 0, 4],
    safe: { radius: 0.5 },
    frames: { width: 32, height: 18, codec: "avc1.42C00A", key_every: 2, offsets },
    live: null,
  };
  return { manifest, bytes, data: decodePayload(new Uint8Array(bytes), manifest) };
}

/** A scene with bound splats, as the program writes it (`crates/m4_viewer/tests/payload_fixture.rs`). */
export function turningFixture(): Fixture {
  const file = new URL("../../../tests/payload/turning.json", import.meta.url);
  const { splats, payload } = JSON.parse(readFileSync(file, "utf8")) as { splats: Manifest["splats"]; payload: string };
  const bytes = Buffer.from(payload, "base64");
  const { manifest: other } = fixture();
  const frames = 10;
  const cameras = other.cameras.map((c, i) => ({ ...c, t: (i * (frames - 1)) / 2, fx: 190, fy: 190 }));
  const manifest: Manifest = { ...other, title: "Turning", splats, time_frames: frames, period_frames: frames - 1, cameras };
  return { manifest, bytes, data: decodePayload(new Uint8Array(bytes), manifest) };
}

export interface Elements {
  /** What is shown while the rest is read. */
  poster: string | null;
  manifest: string | null;
  splats: string | null;
  frames: string | null;
}

/** What goes into the page, as text. */
export function elements({ manifest, bytes }: Fixture): Elements {
  return {
    poster: POSTER,
    manifest: JSON.stringify(manifest).replaceAll("</", "<\\/"),
    splats: gzipSync(bytes).toString("base64"),
    frames: Buffer.concat(CODED).toString("base64"),
  };
}

/** The built page with these elements. */
export function pageWith(parts: Elements): string {
  const template = readFileSync(new URL("../../../page.html", import.meta.url), "utf8");
  const tag = (type: string, id: string, text: string | null): string =>
    text === null ? "" : `<script type="${type}" id="${id}">${text}</script>`;
  const data = [
    parts.poster === null
      ? ""
      : `<img id="m4-poster" alt="" style="--aspect:1.777778" src="data:image/jpeg;base64,${parts.poster}">`,
    tag("application/json", "m4-manifest", parts.manifest),
    tag("text/plain", "m4-splats", parts.splats),
    tag("text/plain", "m4-frames", parts.frames),
  ].join("");
  const [before, after, ...more] = template.split("<!--minute4d-data-->");
  if (before === undefined || after === undefined || more.length > 0) throw new Error("the page has no single marker");
  return before + data + after;
}
