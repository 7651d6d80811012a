/** Short messages over the image. */

import { control, find, setText } from "./dom";

const TOAST_MS = 2600;
let toastTimer = 0;

/** Says that something was done, for a moment. */
export function toast(text: string): void {
  const element = find(HTMLElement, "#toast");
  setText(element, text);
  element.hidden = false;
  window.clearTimeout(toastTimer);
  toastTimer = window.setTimeout(() => {
    element.hidden = true;
  }, TOAST_MS);
}

/** Says something for as long as it is so, `null` when it is not any more; with or without the offer to turn further. */
export function hint(text: string | null, further: boolean): void {
  const element = find(HTMLElement, "#hint");
  if (text !== null) {
    setText(find(HTMLElement, "span", element), text);
    control(HTMLElement, "further").hidden = !further;
  }
  if (element.hidden !== (text === null)) element.hidden = text === null;
}
