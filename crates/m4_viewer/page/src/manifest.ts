/** Reads and checks the manifest: nothing further down meets a missing or senseless field. */

import { PageError } from "./errors";
import type { FrameIndex, LiveSource, Manifest, SourceCamera } from "./scene";

function damaged(what: string): PageError {
  return new PageError(
    "The scene in this page is damaged",
    `The manifest does not hold ${what}. Export the page again from its scene.`,
  );
}

/** One level of the manifest, with its path for messages. */
class Fields {
  constructor(
    private readonly values: Record<string, unknown>,
    private readonly path: string,
  ) {}

  static of(value: unknown, path: string): Fields {
    if (typeof value !== "object" || value === null || Array.isArray(value)) {
      throw damaged(`an object at \`${path || "the top"}\``);
    }
    return new Fields(value as Record<string, unknown>, path === "" ? "" : `${path}.`);
  }

  get(name: string): unknown {
    return this.values[name];
  }

  number(name: string, check: (v: number) => boolean = () => true): number {
    const v = this.values[name];
    if (typeof v !== "number" || !Number.isFinite(v) || !check(v)) throw damaged(`a sensible \`${this.path}${name}\``);
    return v;
  }

  count(name: string, most = 2 ** 31): number {
    return this.number(name, (v) => Number.isInteger(v) && v >= 0 && v <= most);
  }

  text(name: string): string {
    const v = this.values[name];
    if (typeof v !== "string") throw damaged(`a text \`${this.path}${name}\``);
    return v;
  }

  flag(name: string): boolean {
    const v = this.values[name];
    if (typeof v !== "boolean") throw damaged(`true or false at \`${this.path}${name}\``);
    return v;
  }

  numbers(name: string, length?: number): number[] {
    const v = this.values[name];
    const fits =
      Array.isArray(v) &&
      (length === undefined || v.length === length) &&
      v.every((x) => typeof x === "number" && Number.isFinite(x));
    if (!fits) throw damaged(`${length ?? ""} numbers at \`${this.path}${name}\``);
    return v as number[];
  }

  list(name: string): unknown[] {
    const v = this.values[name];
    if (!Array.isArray(v)) throw damaged(`a list \`${this.path}${name}\``);
    return v;
  }

  object(name: string): Fields {
    return Fields.of(this.values[name], `${this.path}${name}`);
  }
}

const positive = (v: number): boolean => v > 0;

function camera(value: unknown, index: number): SourceCamera {
  const f = Fields.of(value, `cameras[${index}]`);
  const sigma = f.get("distance_sigma") ?? undefined;
  return {
    t: f.number("t"),
    c2w: f.numbers("c2w", 16),
    fx: f.number("fx", positive),
    fy: f.number("fy", positive),
    cx: f.number("cx"),
    cy: f.number("cy"),
    width: f.number("width", positive),
    height: f.number("height", positive),
    ...(sigma === undefined ? {} : { distance_sigma: f.number("distance_sigma", positive) }),
  };
}

function frames(value: unknown, cameras: number): FrameIndex | null {
  if (value === null || value === undefined) return null;
  const f = Fields.of(value, "frames");
  const offsets = f.numbers("offsets");
  const ordered = offsets.every((v, i) => Number.isInteger(v) && v >= 0 && (i === 0 || v >= (offsets[i - 1] ?? 0)));
  if (!ordered || offsets.length !== cameras + 1) {
    throw damaged(`one more of \`frames.offsets\`, in order, than the ${cameras} cameras`);
  }
  const whole = (v: number): boolean => Number.isInteger(v) && v > 0;
  return {
    width: f.number("width", whole),
    height: f.number("height", whole),
    codec: f.text("codec"),
    key_every: f.number("key_every", whole),
    offsets,
  };
}

function live(value: unknown): LiveSource | null {
  if (value === null || value === undefined) return null;
  const f = Fields.of(value, "live");
  return { events: f.text("events"), scene: f.text("scene"), token: f.text("token") };
}

/** A checked manifest of parsed JSON; throws a [PageError] that names the field. */
export function readManifest(value: unknown): Manifest {
  const f = Fields.of(value, "");
  if (f.get("version") !== 2) {
    throw new PageError(
      "This scene is of another version",
      `The page reads version 2 and found ${JSON.stringify(f.get("version") ?? null)}. Export the page again with the same release of minute4d.`,
    );
  }
  const splats = f.object("splats");
  const cameras = f.list("cameras").map(camera);
  cameras.forEach((c, i) => {
    if (c.t < (cameras[i - 1]?.t ?? -Infinity)) throw damaged("`cameras` in the order of time");
  });
  const [red = 0, green = 0, blue = 0] = f.numbers("background", 3);
  const [x = 0, y = 0, z = 0] = f.numbers("centre", 3);
  const duration = f.get("duration_s");
  return {
    version: 2,
    title: f.text("title"),
    splats: {
      static: splats.count("static"),
      dynamic: splats.count("dynamic"),
      bound: splats.get("bound") === undefined ? 0 : splats.count("bound", splats.count("dynamic")),
      sh_degree: splats.count("sh_degree", 3),
      time_degree: splats.count("time_degree", 2),
      isotropic: splats.flag("isotropic"),
      bytes: splats.count("bytes", Number.MAX_SAFE_INTEGER),
    },
    background: [red, green, blue],
    time_frames: f.count("time_frames"),
    duration_s: duration === null || duration === undefined ? null : f.number("duration_s", (v) => v >= 0),
    fps: f.number("fps", positive),
    mip: f.flag("mip"),
    near: f.number("near", (v) => v >= 0),
    period_frames: f.number("period_frames", positive),
    cameras,
    centre: [x, y, z],
    safe: { radius: f.object("safe").number("radius", (v) => v >= 0) },
    frames: frames(f.get("frames"), cameras.length),
    live: live(f.get("live")),
  };
}
