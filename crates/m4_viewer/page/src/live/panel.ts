/** How training goes on: how far it is, and loss, PSNR and number of splats over the iterations. */

import { NARROW } from "../ui/layout";
import { find, icon, make, makeSvg, setText } from "../ui/dom";
import type { Metrics } from "./events";
import { Series, linePath } from "./series";

export type RunState = "waiting" | "training" | "finished" | "failed" | "disconnected";

const WORDS: Readonly<Record<RunState, string>> = {
  waiting: "Waiting",
  training: "Training",
  finished: "Finished",
  failed: "Stopped with an error",
  disconnected: "Connection lost",
};
const [WIDTH, HEIGHT] = [232, 40];

class Plot {
  readonly element: HTMLElement;
  private readonly value = make("b");
  private readonly line = makeSvg("path", { class: "line" });
  private readonly area = makeSvg("path", { class: "area" });
  private readonly series = new Series();

  constructor(
    readonly name: string,
    private readonly format: (v: number) => string,
  ) {
    const svg = makeSvg("svg", {
      viewBox: `0 0 ${WIDTH} ${HEIGHT}`,
      preserveAspectRatio: "none",
      role: "img",
      "aria-label": `${name} over the iterations`,
    });
    svg.append(makeSvg("path", { class: "base", d: `M0,${HEIGHT}H${WIDTH}` }), this.area, this.line);
    this.element = make("figure", "plot", make("figcaption", "", make("span", "", name), this.value));
    this.element.append(svg);
    this.element.dataset["plot"] = name.toLowerCase();
  }

  push(x: number, y: number): void {
    this.series.push(x, y);
    const { last, points } = this.series;
    setText(this.value, last ? this.format(last.y) : "–");
    const path = linePath(points, WIDTH, HEIGHT);
    this.line.setAttribute("d", path);
    this.area.setAttribute("d", path === "" ? "" : `${path}V${HEIGHT}H0Z`);
  }
}

const count = (v: number): string => Math.round(v).toLocaleString("en");

export class LivePanel {
  private readonly root = find(HTMLElement, "#live");
  private readonly word = make("span");
  private readonly count = make("span", "count");
  private readonly fill = make("span");
  private readonly plots = {
    psnr: new Plot("PSNR", (v) => `${v.toFixed(2)} dB`),
    loss: new Plot("Loss", (v) => v.toPrecision(3)),
    splats: new Plot("Splats", count),
  };

  constructor() {
    const fold = make("button", "icon", icon("live"));
    fold.type = "button";
    fold.dataset["control"] = "live";
    fold.setAttribute("aria-label", "Show or hide the plots");
    fold.addEventListener("click", () => this.fold(!this.root.classList.contains("folded")));
    const header = make("header", "", make("h2", "", make("span", "dot"), this.word), this.count, fold);
    const body = make("div", "body", make("div", "bar", this.fill));
    body.append(...Object.values(this.plots).map((p) => p.element));
    this.root.append(header, body);
    this.fold(NARROW.matches);
    this.set("waiting");
  }

  private fold(folded: boolean): void {
    this.root.classList.toggle("folded", folded);
    this.root.querySelector("button")?.setAttribute("aria-expanded", String(!folded));
  }

  /** A page without a run has nothing to tell. */
  show(): void {
    this.root.hidden = false;
  }

  set(state: RunState): void {
    this.root.dataset["state"] = state;
    setText(this.word, WORDS[state]);
  }

  get state(): RunState {
    return this.root.dataset["state"] as RunState;
  }

  push(metrics: Metrics): void {
    this.show();
    const { iteration, iterations } = metrics;
    const known = Number.isFinite(iterations) && iterations > 0;
    setText(this.count, known ? `${count(iteration)} / ${count(iterations)}` : count(iteration));
    this.fill.style.transform = `scaleX(${known ? Math.min(iteration / iterations, 1) : 0})`;
    this.plots.psnr.push(iteration, metrics.psnr);
    this.plots.loss.push(iteration, metrics.loss);
    this.plots.splats.push(iteration, metrics.splats);
  }
}
