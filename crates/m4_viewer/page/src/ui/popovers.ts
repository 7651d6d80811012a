/** The sheet of a narrow window and the speed of a wide one: opened by a button, closed by anything else. */

import { control, find } from "./dom";

interface Popover {
  readonly button: HTMLElement;
  readonly panel: HTMLElement;
}

export class Popovers {
  private readonly all: readonly Popover[];

  constructor() {
    this.all = [
      { button: control(HTMLElement, "more"), panel: find(HTMLElement, "#sheet") },
      { button: control(HTMLElement, "speed-open"), panel: find(HTMLElement, "#speed-popover") },
    ];
    for (const popover of this.all) {
      popover.button.addEventListener("click", () => this.toggle(popover));
    }
    document.addEventListener("pointerdown", (event) => {
      const target = event.target;
      if (!(target instanceof Node)) return;
      for (const p of this.all) {
        if (!p.panel.contains(target) && !p.button.contains(target)) this.set(p, false);
      }
    });
  }

  get open(): boolean {
    return this.all.some((p) => !p.panel.hidden);
  }

  close(): void {
    for (const p of this.all) {
      const inside = p.panel.contains(document.activeElement);
      this.set(p, false);
      if (inside) p.button.focus();
    }
  }

  private toggle(popover: Popover): void {
    const opens = popover.panel.hidden !== false;
    this.close();
    this.set(popover, opens);
  }

  private set({ button, panel }: Popover, open: boolean): void {
    if (panel.hidden === !open) return;
    panel.hidden = !open;
    button.setAttribute("aria-expanded", String(open));
    if (!open) return;
    if (panel.classList.contains("popover")) {
      const box = button.getBoundingClientRect();
      const x = box.left + (box.width - panel.offsetWidth) / 2;
      panel.style.left = `${Math.min(Math.max(8, x), window.innerWidth - panel.offsetWidth - 8)}px`;
      panel.style.top = `${box.top - panel.offsetHeight - 12}px`;
    }
    panel.querySelector<HTMLElement>("input, button")?.focus({ preventScroll: true });
  }
}
