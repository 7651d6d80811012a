/** What the page does besides showing the scene: links, images, full screen, help. */

import type { App } from "../app";
import { fromFragment, toFragment } from "../link";
import { control, setAttribute, setIcon } from "./dom";
import type { Help } from "./help";
import type { Meter } from "./meter";
import { toast } from "./notices";
import type { Popovers } from "./popovers";
import { toggleTheme } from "./theme";

export class Actions {
  constructor(
    private readonly app: App,
    private readonly root: HTMLElement,
    private readonly help: Help,
    private readonly popovers: Popovers,
    private readonly meter: Meter,
  ) {
    window.addEventListener("hashchange", () => {
      const place = fromFragment(location.hash);
      if (place) app.go(place);
    });
    document.addEventListener("fullscreenchange", () => this.showFullscreen());
    control(HTMLElement, "fullscreen").hidden = !document.fullscreenEnabled;
  }

  /** Whether a panel has the keys. */
  get busy(): boolean {
    return this.help.open;
  }

  /** Whether something is open that must not go away by itself. */
  get open(): boolean {
    return this.help.open || this.popovers.open;
  }

  say(text: string): void {
    toast(text);
  }

  escape(): void {
    this.popovers.close();
  }

  toggleHelp(): void {
    this.popovers.close();
    this.help.toggle();
  }

  toggleMeter(): void {
    this.meter.toggle();
  }

  toggleTheme(): void {
    toast(toggleTheme() === "light" ? "Light theme" : "Dark theme");
  }

  /** The address of what is seen now, in the clipboard and in the address bar. */
  async copyLink(): Promise<void> {
    const url = new URL(location.href);
    url.hash = toFragment(this.app.place);
    try {
      history.replaceState(null, "", url);
    } catch {
      // a page from a file may be refused; the link itself is good
    }
    toast((await copy(url.href)) ? "Link copied" : "The link is in the address bar");
  }

  /** The image without the controls, as a PNG. */
  async savePicture(): Promise<void> {
    await this.app.settle();
    const blob = await new Promise<Blob | null>((resolve) => this.app.stage.canvas.toBlob(resolve, "image/png"));
    if (!blob) {
      toast("The image could not be saved");
      return;
    }
    const name = this.app.manifest.title.replace(/[^\p{L}\p{N}]+/gu, "-").replace(/^-+|-+$/g, "") || "minute4d";
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${name}-${this.app.time.toFixed(1)}.png`;
    link.click();
    window.setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    toast("Image saved");
  }

  async toggleFullscreen(): Promise<void> {
    try {
      if (document.fullscreenElement) await document.exitFullscreen();
      else await this.root.requestFullscreen();
    } catch {
      toast("Full screen is not available here");
    }
  }

  private showFullscreen(): void {
    const button = control(HTMLElement, "fullscreen");
    const full = document.fullscreenElement !== null;
    setIcon(button, full ? "window" : "fullscreen");
    setAttribute(button, "aria-label", full ? "Leave full screen" : "Full screen");
  }
}

async function copy(text: string): Promise<boolean> {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return false;
  }
}
