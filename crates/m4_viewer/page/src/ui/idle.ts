/** Hides the controls while the scene plays without input. */

const WAIT_MS = 2600;

export class Idle {
  private timer = 0;

  constructor(
    private readonly root: HTMLElement,
    /** Whether controls may go now. */
    private readonly allowed: () => boolean,
  ) {
    for (const type of ["pointermove", "pointerdown", "keydown", "focusin", "wheel"]) {
      window.addEventListener(type, () => this.wake(), { passive: true });
    }
    this.wake();
  }

  get idle(): boolean {
    return this.root.classList.contains("idle");
  }

  /** Shows the controls and counts from the beginning. */
  wake(): void {
    this.root.classList.remove("idle");
    window.clearTimeout(this.timer);
    this.timer = window.setTimeout(() => this.rest(), WAIT_MS);
  }

  /** Hides the controls at once. */
  hide(): void {
    window.clearTimeout(this.timer);
    this.root.classList.add("idle");
  }

  private rest(): void {
    if (this.allowed()) this.hide();
    else this.timer = window.setTimeout(() => this.rest(), WAIT_MS);
  }
}
