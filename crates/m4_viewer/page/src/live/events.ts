/** What a training run tells while it goes on. Anything else in the stream is left alone. */

export interface Metrics {
  readonly event: "metrics";
  readonly iteration: number;
  /** Of the whole run. */
  readonly iterations: number;
  readonly loss: number;
  /** dB. */
  readonly psnr: number;
  readonly splats: number;
}

export interface SceneReady {
  readonly event: "scene";
  readonly version: number;
}

export interface RunEnd {
  readonly event: "end";
  readonly ok: boolean;
}

export type LiveEvent = Metrics | SceneReady | RunEnd;

/** An event of the stream; `null` for text that is none of ours. */
export function readEvent(text: string): LiveEvent | null {
  let value: unknown;
  try {
    value = JSON.parse(text);
  } catch {
    return null;
  }
  if (typeof value !== "object" || value === null) return null;
  const fields = value as Record<string, unknown>;
  const number = (name: string): number => {
    const v = fields[name];
    return typeof v === "number" ? v : Number.NaN;
  };
  switch (fields["event"]) {
    case "metrics": {
      const iteration = number("iteration");
      if (!Number.isFinite(iteration)) return null;
      return {
        event: "metrics",
        iteration,
        iterations: number("iterations"),
        loss: number("loss"),
        psnr: number("psnr"),
        splats: number("splats"),
      };
    }
    case "scene":
      return { event: "scene", version: number("version") };
    case "end":
      return { event: "end", ok: fields["ok"] === true };
    default:
      return null;
  }
}
