/** What the page and its worker say to each other. */

import type { Manifest } from "../scene";
import type { Texels } from "./columns";
import type { Slice, SliceView } from "./slice";

export type ToWorker =
  | { readonly kind: "load"; readonly manifest: Manifest; readonly bytes: Uint8Array<ArrayBuffer> }
  | { readonly kind: "slice"; readonly view: SliceView };

export type FromWorker =
  | { readonly kind: "progress"; readonly share: number; readonly doing: string }
  /** `nodes`: texels of the texture of nodes, 0 without bound splats. */
  | { readonly kind: "loaded"; readonly texels: Texels; readonly nodes: number }
  /** `sentMs`: when it left the worker, on the clock of both (`performance.timeOrigin` added). */
  | { readonly kind: "sliced"; readonly slice: Slice; readonly sentMs: number }
  | { readonly kind: "failed"; readonly title: string; readonly advice: string };

/** Milliseconds on a clock that page and worker share. */
export const sharedNow = (): number => performance.timeOrigin + performance.now();
