/** Unpacks the splats, and slices and sorts them for an instant, beside the page. */

import { gunzip, isGzip } from "../bytes";
import { PageError, toPageError } from "../errors";
import { decodePayload } from "../payload";
import { colourTerms } from "../scene";
import { texelsOf } from "./columns";
import { type FromWorker, type ToWorker, sharedNow } from "./messages";
import { MOST_NODES } from "./pose";
import { Slicer } from "./slice";

let slicer: Slicer | null = null;

const say = (message: FromWorker, transfer: Transferable[] = []): void => {
  self.postMessage(message, { transfer });
};

async function load({ manifest, bytes }: Extract<ToWorker, { kind: "load" }>): Promise<void> {
  const progress = (share: number, doing: string): void => say({ kind: "progress", share, doing });
  progress(0, "Unpacking");
  const payload = isGzip(bytes)
    ? await gunzip(bytes, "splats", (count) => progress(0.5 * Math.min(1, count / Math.max(1, manifest.splats.bytes)), "Unpacking"))
    : bytes;
  progress(0.5, "Decoding");
  const data = decodePayload(payload, manifest);
  progress(0.7, "Preparing");
  slicer = new Slicer(data, manifest.near);
  progress(0.85, "Preparing");
  const { nodes } = slicer;
  if (nodes.count > MOST_NODES) {
    throw new PageError(
      "This scene is too large for this page",
      `Its windows have ${nodes.count} nodes at one time and the page shows ${MOST_NODES}. Export the scene with fewer.`,
    );
  }
  const texels = texelsOf(data, colourTerms(manifest), nodes.places);
  say(
    { kind: "loaded", texels, nodes: nodes.texels.length / 4 },
    Object.values(texels).map((t: Float32Array<ArrayBuffer>) => t.buffer),
  );
}

async function answer(message: ToWorker): Promise<void> {
  if (message.kind === "load") {
    await load(message);
    return;
  }
  if (!slicer) throw new Error("the splats are not loaded yet");
  const slice = slicer.slice(message.view);
  say({ kind: "sliced", slice, sentMs: sharedNow() }, [slice.ids.buffer as ArrayBuffer, slice.nodes.buffer]);
}

self.addEventListener("message", (event: MessageEvent<ToWorker>) => {
  answer(event.data).catch((error: unknown) => {
    const { title, advice } = toPageError(error);
    say({ kind: "failed", title, advice });
  });
});
