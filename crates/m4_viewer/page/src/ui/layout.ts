/** Where each control is: in the dock and the bar above on a wide window, in a sheet on a narrow one. */

import { control, find } from "./dom";

export const NARROW = window.matchMedia("(max-width: 719px)");

const BAR = ["link", "screenshot", "theme", "help", "headset", "fullscreen"] as const;
const PLAYBACK = ["speed-open", "loop", "side", "reset"] as const;
const GRID = ["side", "loop", "reset", "screenshot", "link", "theme", "help", "headset", "fullscreen"] as const;

const slot = (name: string): HTMLElement => find(HTMLElement, `[data-slot="${name}"]`);

function arrange(): void {
  const segments = find(HTMLElement, ".seg");
  const speed = find(HTMLElement, ".speed-field");
  const put = (into: HTMLElement, names: readonly string[]): void =>
    into.append(...names.map((n) => control(HTMLElement, n)));
  if (NARROW.matches) {
    slot("sheet-camera").append(segments);
    slot("sheet-speed").append(speed);
    put(slot("sheet-grid"), GRID);
    put(find(HTMLElement, "#parts"), ["speed-open"]);
  } else {
    slot("camera").append(segments);
    find(HTMLElement, "#speed-popover").append(speed);
    put(slot("tools"), BAR);
    put(slot("playback"), PLAYBACK);
  }
}

/** Arranges now and whenever the window becomes wide or narrow. */
export function startLayout(onChange: () => void): void {
  arrange();
  NARROW.addEventListener("change", () => {
    arrange();
    onChange();
  });
}
