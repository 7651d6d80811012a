/** What an instant costs, in a corner, for who wants to know. */

import type { App } from "../app";
import { find, setText } from "./dom";

const REFRESH_MS = 250;

export class Meter {
  private readonly root = find(HTMLElement, "#meter");
  private timer = 0;

  constructor(private readonly app: App) {}

  toggle(): void {
    this.root.hidden = !this.root.hidden;
    window.clearInterval(this.timer);
    if (this.root.hidden) return;
    this.refresh();
    this.timer = window.setInterval(() => this.refresh(), REFRESH_MS);
  }

  private refresh(): void {
    const { stage, manifest } = this.app;
    const { slice, readback, sort, draw } = stage.timing.cost;
    const ms = (name: string, v: number): string => `${name.padEnd(9)}${v.toFixed(1).padStart(7)} ms`;
    const count = (v: number): string => v.toLocaleString("en");
    const lines = [
      `${stage.timing.rate(performance.now()).toFixed(1)} instants per second`,
      `${count(stage.active)} of ${count(manifest.splats.static + manifest.splats.dynamic)} splats`,
      ms("slice", slice),
      ms("readback", readback),
      ms("sort", sort),
      ms("draw", draw),
      `${stage.canvas.width} x ${stage.canvas.height} pixels`,
    ];
    setText(this.root, lines.join("\n"));
  }
}
