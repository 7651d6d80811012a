/** Text in the page to bytes: base64, then gzip. */

import { PageError, messageOf } from "./errors";

/** Characters that are decoded at a time; a multiple of 4. */
const CHUNK = 1 << 20;

/** Lets the page paint. */
export const breath = (): Promise<void> => new Promise((resolve) => setTimeout(resolve, 0));

function damaged(what: string, cause: unknown): PageError {
  return new PageError(
    "The data in this page is damaged",
    `The ${what} could not be read (${messageOf(cause)}). The file was truncated or changed in transit: download it again, or export it again from the scene.`,
    { cause },
  );
}

/** The browser's own decoder, where it has one: many times as fast. */
const native = (Uint8Array as { fromBase64?: (text: string) => Uint8Array }).fromBase64;

function decodePiece(text: string): Uint8Array {
  if (native) return native.call(Uint8Array, text);
  const characters = atob(text);
  const out = new Uint8Array(characters.length);
  for (let k = 0; k < characters.length; k++) out[k] = characters.charCodeAt(k);
  return out;
}

/** Decodes base64; calls `progress` with 0..1 and lets the page paint in between. */
export async function fromBase64(
  text: string,
  what: string,
  progress: (share: number) => void = () => undefined,
): Promise<Uint8Array<ArrayBuffer>> {
  const clean = /\s/.test(text) ? text.replace(/\s+/g, "") : text;
  const padding = clean.endsWith("==") ? 2 : clean.endsWith("=") ? 1 : 0;
  const out = new Uint8Array(Math.max(0, (clean.length / 4) * 3 - padding) | 0);
  let at = 0;
  try {
    for (let i = 0; i < clean.length; i += CHUNK) {
      const piece = decodePiece(clean.slice(i, i + CHUNK));
      out.set(piece, at);
      at += piece.length;
      progress(Math.min(1, (i + CHUNK) / clean.length));
      await breath();
    }
  } catch (error) {
    throw damaged(what, error);
  }
  if (at !== out.length) throw damaged(what, `${at} bytes instead of ${out.length}`);
  return out;
}

/** Whether bytes begin as gzip does. */
export const isGzip = (bytes: Uint8Array): boolean => bytes[0] === 0x1f && bytes[1] === 0x8b;

/** Inflates gzip; calls `progress` with the bytes that are there so far. */
export async function gunzip(
  bytes: Uint8Array<ArrayBuffer>,
  what: string,
  progress: (count: number) => void = () => undefined,
): Promise<Uint8Array<ArrayBuffer>> {
  if (typeof DecompressionStream === "undefined") {
    throw new PageError(
      "This browser is too old for the page",
      "It cannot decompress gzip. Chrome 80, Firefox 113 and Safari 16.4 or newer can.",
    );
  }
  try {
    const parts: Uint8Array[] = [];
    const reader = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")).getReader();
    let count = 0;
    let told = 0;
    for (let next = await reader.read(); !next.done; next = await reader.read()) {
      parts.push(next.value);
      count += next.value.length;
      if (count - told < CHUNK) continue;
      told = count;
      progress(count);
    }
    const out = new Uint8Array(parts.reduce((sum, p) => sum + p.length, 0));
    let at = 0;
    for (const part of parts) {
      out.set(part, at);
      at += part.length;
    }
    return out;
  } catch (error) {
    throw damaged(what, error);
  }
}
