/** The input frame above the pointer while it is over the time line. */

import type { App } from "../app";
import { timecode } from "../clock";
import type { SourceFrames } from "../frames";
import { clamp } from "../maths";
import { control, find, setText } from "./dom";

const WIDTH_PX = 144;

export function startScrubThumb(app: App, frames: SourceFrames): void {
  const scrub = control(HTMLInputElement, "scrub");
  const thumb = find(HTMLElement, ".thumb");
  const canvas = find(HTMLCanvasElement, ".thumb canvas");
  const label = find(HTMLElement, ".thumb span");
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const height = (WIDTH_PX * frames.index.height) / frames.index.width;
  canvas.width = Math.round(WIDTH_PX * ratio);
  canvas.height = Math.round(height * ratio);
  canvas.style.width = `${WIDTH_PX}px`;
  let wanted = -1;

  scrub.addEventListener("pointermove", (event) => {
    const box = scrub.getBoundingClientRect();
    const share = clamp((event.clientX - box.left - 8) / Math.max(box.width - 16, 1), 0, 1);
    const t = app.clock.start + share * app.clock.length;
    thumb.hidden = false;
    const own = thumb.offsetWidth;
    thumb.style.left = `${clamp(event.clientX - box.left - own / 2, 0, box.width - own)}px`;
    setText(label, timecode((t - app.clock.start) / app.clock.fps));
    const index = clamp(app.rig.path.nearestIndex(t), 0, frames.count - 1);
    if (index === wanted) return;
    wanted = index;
    frames.frame(index).then(
      (bitmap) => {
        if (wanted === index) canvas.getContext("2d")?.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
      },
      () => undefined,
    );
  });
  const hide = (): void => {
    thumb.hidden = true;
  };
  scrub.addEventListener("pointerleave", hide);
  scrub.addEventListener("pointercancel", hide);
  scrub.addEventListener("pointerup", (event) => {
    if (event.pointerType !== "mouse") hide();
  });
}
