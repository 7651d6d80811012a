/** What the page carries with it: manifest, splats, frames of the clip. */

import { fromBase64 } from "./bytes";
import { PageError, messageOf } from "./errors";
import { readManifest } from "./manifest";
import type { Manifest } from "./scene";

/** How far loading is: 0..1, and what is done. */
export type Progress = (share: number, doing: string) => void;

function text(id: string): string | null {
  const element = document.getElementById(id);
  return element?.textContent ?? null;
}

/** The manifest in the page. */
export function embeddedManifest(): Manifest {
  const json = text("m4-manifest");
  if (json === null) {
    throw new PageError(
      "There is no scene in this page",
      "It is the empty viewer. `minute4d run` writes one with a scene in it, `minute4d view` shows one.",
    );
  }
  try {
    return readManifest(JSON.parse(json));
  } catch (error) {
    if (error instanceof PageError) throw error;
    throw new PageError(
      "The scene in this page is damaged",
      `Its manifest is not JSON (${messageOf(error)}). Download the file again, or export it again from the scene.`,
      { cause: error },
    );
  }
}

/** The splats in the page, packed; `null` where there are none yet, which only a live page may lack. */
export async function embeddedSplats(manifest: Manifest, progress: Progress): Promise<Uint8Array<ArrayBuffer> | null> {
  const base64 = text("m4-splats");
  if (base64 === null || base64.trim() === "") {
    if (manifest.live) return null;
    throw new PageError(
      "The scene in this page is truncated",
      "The manifest is complete, but the splats are missing. Download the file again, or export it again from the scene.",
    );
  }
  const packed = await fromBase64(base64, "splats", (s) => progress(s, "Reading"));
  document.getElementById("m4-splats")?.remove();
  return packed;
}

/** The frames of the clip in the page, as they are; `null` where there are none. */
export async function embeddedFrames(manifest: Manifest): Promise<Uint8Array<ArrayBuffer> | null> {
  if (!manifest.frames) return null;
  const base64 = text("m4-frames");
  if (base64 === null || base64.trim() === "") return null;
  const bytes = await fromBase64(base64, "input frames");
  document.getElementById("m4-frames")?.remove();
  const end = manifest.frames.offsets.at(-1) ?? 0;
  if (bytes.length < end) {
    throw new PageError(
      "The input frames in this page are truncated",
      `${bytes.length} of ${end} bytes are present. The scene itself can still be seen.`,
    );
  }
  return bytes;
}
