/** What a button does and which key does the same, beside it after a moment. Pointers that hover only. */

import { make } from "./dom";

const WAIT_MS = 450;

export function startTips(root: HTMLElement): void {
  if (!window.matchMedia("(hover: hover)").matches) return;
  const tip = make("div", "tip");
  tip.hidden = true;
  root.append(tip);
  let timer = 0;

  const hide = (): void => {
    window.clearTimeout(timer);
    tip.hidden = true;
  };
  const show = (target: HTMLElement): void => {
    tip.textContent = target.dataset["tip"] ?? "";
    tip.hidden = false;
    const box = target.getBoundingClientRect();
    const own = tip.getBoundingClientRect();
    const above = box.top > own.height + 16;
    const x = Math.min(Math.max(8, box.left + (box.width - own.width) / 2), window.innerWidth - own.width - 8);
    tip.style.left = `${x}px`;
    tip.style.top = `${above ? box.top - own.height - 8 : box.bottom + 8}px`;
  };
  root.addEventListener("pointerover", (event) => {
    const target = event.target instanceof Element ? event.target.closest("[data-tip]") : null;
    hide();
    if (target instanceof HTMLElement && event.pointerType === "mouse") {
      timer = window.setTimeout(() => show(target), WAIT_MS);
    }
  });
  root.addEventListener("pointerdown", hide);
  root.addEventListener("keydown", hide);
}
