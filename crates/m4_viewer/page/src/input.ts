/** Mouse, fingers, wheel on the image, and keys. */

import type { App } from "./app";
import { flies, pushOf } from "./camera/fly";
import { clamp } from "./maths";

/** A drag over the shorter side of the window turns by this at most and at least, radians. */
const TURN_MOST = 2.4;
const TURN_LEAST = 0.6;
/** In between it is so many times the way to where the camera stops: little room, fine steps. */
const TURN_ROOMS = 2.5;
const WHEEL = 0.0012;
/** A wheel that counts lines turns by as many pixels each. */
const LINE_PX = 16;
/** Less than this is a tap, pixels. */
const TAP_PX = 8;
const TAP_MS = 350;

interface Finger {
  x: number;
  y: number;
}

/** Whether the controls are out of sight, and a touch that did not move. */
export interface Taps {
  hidden(): boolean;
  /** `wasHidden`: when the finger came down, which by itself brings the controls back. */
  tap(wasHidden: boolean): void;
}

/** Drags on the image. */
export function startPointer(canvas: HTMLCanvasElement, app: App, taps: Taps): void {
  const fingers = new Map<number, Finger>();
  let travelled = 0;
  let began = 0;
  let wasHidden = false;
  let spin = { yaw: 0, pitch: 0, at: 0 };

  const shorter = (): number => Math.max(1, Math.min(canvas.clientWidth, canvas.clientHeight));
  /** Radians a pixel: in flight the scene stays under the pointer. */
  const perPixel = (): number => {
    const lens = app.view?.lens;
    if (app.rig.mode === "fly" && lens) return lens.width / canvas.clientWidth / lens.fx;
    return clamp(TURN_ROOMS * app.rig.turnRoom(app.clock.time), TURN_LEAST, TURN_MOST) / shorter();
  };
  /** Pixels of the window a focal length. */
  const focal = (): number => {
    const lens = app.view?.lens;
    return lens ? (lens.fx * canvas.clientWidth) / lens.width : shorter();
  };
  const pan = (dx: number, dy: number): void => app.touch((rig, t) => rig.pan(dx / focal(), dy / focal(), t));

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus({ preventScroll: true });
    if (fingers.size === 0) {
      travelled = 0;
      began = event.timeStamp;
      wasHidden = taps.hidden();
    }
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    spin = { yaw: 0, pitch: 0, at: event.timeStamp };
    canvas.classList.add("dragging");
  });

  canvas.addEventListener("pointermove", (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) return;
    const [dx, dy] = [event.clientX - finger.x, event.clientY - finger.y];
    if (dx === 0 && dy === 0) return;
    travelled += Math.hypot(dx, dy);
    if (event.pointerType !== "mouse" && travelled < TAP_PX) {
      return;
    }
    if (fingers.size >= 2) {
      const others = [...fingers.entries()].filter(([id]) => id !== event.pointerId).map(([, f]) => f);
      const other = others[0];
      if (other) {
        const before = Math.hypot(finger.x - other.x, finger.y - other.y);
        const after = Math.hypot(event.clientX - other.x, event.clientY - other.y);
        // one finger of two: the middle moves half as far
        pan(dx / 2, dy / 2);
        if (before > 1 && after > 1) app.touch((rig, t) => rig.zoom(before / after, t));
      }
    } else if (event.shiftKey || (event.buttons & 6) !== 0) {
      pan(dx, dy);
    } else {
      const k = perPixel();
      const seconds = Math.max(event.timeStamp - spin.at, 4) / 1000;
      spin = { yaw: (-dx * k) / seconds, pitch: (-dy * k) / seconds, at: event.timeStamp };
      app.touch((rig, t) => rig.turn(-dx * k, -dy * k, t));
    }
    finger.x = event.clientX;
    finger.y = event.clientY;
  });

  const up = (event: PointerEvent): void => {
    if (!fingers.delete(event.pointerId)) return;
    if (fingers.size > 0) return;
    canvas.classList.remove("dragging");
    const quick = event.timeStamp - began < TAP_MS;
    if (travelled < TAP_PX && quick && event.pointerType !== "mouse") taps.tap(wasHidden);
    else if (event.timeStamp - spin.at < 60 && event.type === "pointerup" && (spin.yaw !== 0 || spin.pitch !== 0)) {
      app.rig.release(spin.yaw, spin.pitch);
      app.invalidate();
    }
  };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());

  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const px = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? event.deltaY * LINE_PX : event.deltaY;
      // a pinch on a touch pad comes as a wheel with ctrl and small numbers
      const factor = Math.exp(px * WHEEL * (event.ctrlKey ? 6 : 1));
      app.touch((rig, t) => rig.zoom(clamp(factor, 0.5, 2), t));
    },
    { passive: false },
  );
}

/** Keys that fly, held down. `enabled` is false while something else has the keys. */
export function startFlying(app: App, enabled: () => boolean): void {
  const down = new Set<string>();
  const push = (): void => {
    app.rig.push = pushOf(down);
    app.invalidate();
  };
  window.addEventListener("keydown", (event) => {
    if (event.code.startsWith("Shift")) {
      down.add(event.code);
      push();
    }
    if (!flies(event.code) || event.ctrlKey || event.metaKey || event.altKey || !enabled()) return;
    if (event.target instanceof HTMLInputElement || isSlider(event.target)) return;
    event.preventDefault();
    down.add(event.code);
    if (app.rig.mode !== "fly") app.setMode("fly");
    push();
  });
  window.addEventListener("keyup", (event) => {
    if (down.delete(event.code)) push();
  });
  window.addEventListener("blur", () => {
    down.clear();
    push();
  });
}

export function isSlider(target: EventTarget | null): boolean {
  return target instanceof Element && target.getAttribute("role") === "slider";
}
