/** Buttons and keys to the viewer, and the state of the viewer to the buttons. */

import type { App } from "../app";
import { SPEED_MAX, SPEED_MIN, timecode } from "../clock";
import { control, fillRange, find, setAttribute, setIcon, setText } from "./dom";
import type { Actions } from "./actions";

const REPEAT_WORDS = { loop: "Loop", swing: "Back and forth", once: "Once" } as const;
const SPEED_STEPS = [0.1, 0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4] as const;

const speedText = (v: number): string => `${Number(v.toFixed(2))}×`;

export class Dock {
  private readonly scrub = control(HTMLInputElement, "scrub");
  private readonly play = control(HTMLElement, "play");
  private readonly freeze = control(HTMLElement, "freeze");
  private readonly loop = control(HTMLElement, "loop");
  private readonly speed = control(HTMLInputElement, "speed");
  private readonly speedOpen = control(HTMLElement, "speed-open");
  private readonly speedOut = find(HTMLOutputElement, ".speed-field output");
  private readonly now = find(HTMLElement, ".now");
  private readonly whole = find(HTMLElement, ".whole");

  constructor(
    private readonly app: App,
    private readonly actions: Actions,
  ) {
    const on = (name: string, action: () => void): void => control(HTMLElement, name).addEventListener("click", action);
    on("play", () => app.togglePlay());
    on("freeze", () => app.toggleFreeze());
    on("ride", () => app.setMode("ride"));
    on("orbit", () => app.setMode("orbit"));
    on("fly", () => app.setMode("fly"));
    on("loop", () => app.cycleRepeat());
    on("side", () => app.toggleCompare());
    on("reset", () => app.reset());
    on("further", () => this.further());
    on("link", () => void actions.copyLink());
    on("screenshot", () => void actions.savePicture());
    on("theme", () => actions.toggleTheme());
    on("help", () => actions.toggleHelp());
    on("fullscreen", () => void actions.toggleFullscreen());
    this.speed.addEventListener("input", () => app.setSpeed(Number(this.speed.value)));
    this.startScrub();
    // a button that was clicked does not keep the keys: the next Space plays
    document.addEventListener("click", (event) => {
      const button = event.target instanceof Element ? event.target.closest("button") : null;
      if (event.detail > 0 && button && !button.hasAttribute("aria-expanded") && !actions.busy) {
        app.stage.canvas.focus({ preventScroll: true });
      }
    });
    window.addEventListener("keydown", (event) => this.key(event));
    app.onChange(() => this.refresh());
  }

  /** Time stands still under the thumb and goes on afterwards. */
  private startScrub(): void {
    let resume = false;
    this.scrub.addEventListener("pointerdown", () => {
      resume = this.app.clock.playing;
      if (resume) this.app.togglePlay();
    });
    this.scrub.addEventListener("input", () => this.app.seek(Number(this.scrub.value)));
    const release = (): void => {
      if (resume) this.app.togglePlay();
      resume = false;
    };
    this.scrub.addEventListener("pointerup", release);
    this.scrub.addEventListener("pointercancel", release);
    this.scrub.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10 }[event.key];
      if (step === undefined) return;
      event.preventDefault();
      this.app.step(event.shiftKey ? 10 * step : step);
    });
  }

  /** The next step of speed up or down. */
  private faster(sign: number): void {
    const now = this.app.clock.speed;
    const steps = sign > 0 ? SPEED_STEPS : SPEED_STEPS.toReversed();
    const next = steps.find((v) => (v - now) * sign > 1e-6);
    this.app.setSpeed(next ?? (sign > 0 ? SPEED_MAX : SPEED_MIN));
    this.actions.say(`Speed ${speedText(this.app.clock.speed)}`);
  }

  private further(): void {
    if (this.app.turnFurther()) this.actions.say("Moving parts no longer limit the view");
  }

  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    const target = event.target instanceof Element ? event.target : null;
    const onButton = target?.closest("button") !== null && target !== null;
    const onRange = target instanceof HTMLInputElement;
    if (event.key === "Escape") {
      this.actions.escape();
      return;
    }
    if (event.key === "?" || event.code === "KeyH") {
      this.actions.toggleHelp();
      return;
    }
    if (this.actions.busy || ((onButton || onRange) && [" ", "Enter"].includes(event.key) && onButton)) return;
    if (onRange && ["Home", "End"].includes(event.key)) return;
    const command = this.commands()[event.key === " " ? "Space" : event.code] ?? this.commands()[event.key];
    if (!command || (event.repeat && !["Comma", "Period"].includes(event.code))) return;
    event.preventDefault();
    command();
  }

  private commands(): Readonly<Record<string, () => void>> {
    const { app, actions } = this;
    return {
      Space: () => app.togglePlay(),
      KeyF: () => app.toggleFreeze(),
      KeyC: () => app.setMode("ride"),
      KeyO: () => app.setMode("orbit"),
      KeyG: () => app.setMode("fly"),
      KeyL: () => actions.say(REPEAT_WORDS[app.cycleRepeat()]),
      KeyV: () => app.toggleCompare(),
      KeyR: () => app.reset(),
      KeyU: () => this.further(),
      KeyK: () => void actions.copyLink(),
      KeyP: () => void actions.savePicture(),
      KeyT: () => actions.toggleTheme(),
      KeyI: () => actions.toggleMeter(),
      Enter: () => void actions.toggleFullscreen(),
      Comma: () => app.step(-1),
      Period: () => app.step(1),
      Home: () => app.seek(app.clock.start),
      End: () => app.seek(app.clock.end),
      "-": () => this.faster(-1),
      "+": () => this.faster(1),
      "=": () => this.faster(1),
    };
  }

  refresh(): void {
    const { clock, rig, time } = this.app;
    setIcon(this.play, clock.playing ? "pause" : "play");
    setAttribute(this.play, "aria-label", clock.playing ? "Pause" : "Play");
    setAttribute(this.play, "data-tip", clock.playing ? "Pause  (Space)" : "Play  (Space)");

    setAttribute(this.scrub, "min", String(clock.start));
    setAttribute(this.scrub, "max", String(clock.end));
    this.scrub.disabled = clock.length === 0;
    // the thumb stays under the hand; the words are those of the image
    this.scrub.value = String(clock.playing ? time : clock.time);
    fillRange(this.scrub);
    const text = timecode((time - clock.start) / clock.fps);
    setText(this.now, text);
    setText(this.whole, timecode(clock.length / clock.fps));
    setAttribute(this.scrub, "aria-valuetext", `${text}, frame ${Math.round(time)} of ${Math.round(clock.end)}`);

    setAttribute(this.freeze, "aria-pressed", String(this.app.frozen));
    const label = this.freeze.querySelector("span");
    if (label) setText(label, this.app.frozen ? "Resume" : "Freeze");
    setAttribute(
      this.freeze,
      "data-tip",
      this.app.frozen ? "Resume time  (F)" : "Stop time and move around it  (F)",
    );

    for (const mode of ["ride", "orbit", "fly"] as const) {
      setAttribute(control(HTMLElement, mode), "aria-pressed", String(rig.mode === mode));
    }
    this.speed.value = String(clock.speed);
    fillRange(this.speed);
    setText(this.speedOut, speedText(clock.speed));
    setText(this.speedOpen, speedText(clock.speed));
    setAttribute(this.speedOpen, "aria-label", `Speed, now ${speedText(clock.speed)}`);

    setIcon(this.loop, clock.repeat);
    const words = REPEAT_WORDS[clock.repeat];
    const loopLabel = this.loop.querySelector(".label");
    if (loopLabel instanceof HTMLElement) setText(loopLabel, words);
    setAttribute(this.loop, "aria-label", `Repeat: ${words}`);
    setAttribute(this.loop, "data-tip", `${words}  (L)`);
    setAttribute(this.loop, "data-state", clock.repeat);
    setAttribute(control(HTMLElement, "side"), "aria-pressed", String(this.app.comparing));
  }
}
