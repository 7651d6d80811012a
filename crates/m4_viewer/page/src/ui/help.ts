/** The panel that says what can be done, and with which keys. */

import { find, icon, make } from "./dom";

type Line = readonly [what: string, ...keys: string[]];

const HANDS: readonly Line[] = [
  ["Orbit", "Drag"],
  ["Move sideways", "Two fingers", "Right drag"],
  ["Zoom", "Pinch", "Wheel"],
  ["Hide controls", "Tap"],
];
const TIME: readonly Line[] = [
  ["Play or pause", "Space"],
  ["Freeze time", "F"],
  ["Previous, next frame", ",", "."],
  ["Start, end", "Home", "End"],
  ["Slower, faster", "−", "+"],
  ["Loop, back and forth, once", "L"],
];
const CAMERA: readonly Line[] = [
  ["Source camera", "C"],
  ["Orbit", "O"],
  ["Fly", "G"],
  ["Fly forward and sideways", "W", "A", "S", "D"],
  ["Fly down, up", "Q", "E"],
  ["Fly faster", "Shift"],
  ["Reset the view", "R"],
  ["Turn further than moving parts allow", "U"],
];
const PAGE: readonly Line[] = [
  ["Compare with the input", "V"],
  ["Copy a link", "K"],
  ["Save an image", "P"],
  ["Timings per instant", "I"],
  ["Light or dark", "T"],
  ["Full screen", "Enter"],
  ["This help", "?"],
];

function list(title: string, lines: readonly Line[]): HTMLElement {
  const entries = lines.flatMap(([what, ...keys]) => [
    make("dt", "", what),
    make("dd", "", ...keys.map((k) => make("kbd", "", k))),
  ]);
  return make("section", "", make("h3", "", title), make("dl", "", ...entries));
}

export class Help {
  private readonly dialog = find(HTMLDialogElement, "#help");

  constructor() {
    const close = make("button", "icon", icon("close"));
    close.type = "button";
    close.setAttribute("aria-label", "Close");
    close.dataset["control"] = "help-close";
    close.addEventListener("click", () => this.dialog.close());
    const heading = make("h2", "", "Controls");
    heading.id = "help-title";
    const about = make(
      "p",
      "",
      "A scene from one clip is accurate near the source camera. Further away the image fades, " +
        "and the camera stops where nothing is known.",
    );
    const keys = make(
      "div",
      "keys",
      make("div", "", list("Mouse and touch", HANDS), list("Camera", CAMERA)),
      make("div", "", list("Time", TIME), list("Page", PAGE)),
    );
    this.dialog.append(make("header", "", heading, close), about, keys);
    this.dialog.addEventListener("click", (event) => {
      if (event.target === this.dialog) this.dialog.close();
    });
  }

  get open(): boolean {
    return this.dialog.open;
  }

  toggle(): void {
    if (this.dialog.open) this.dialog.close();
    else this.dialog.showModal();
  }
}
