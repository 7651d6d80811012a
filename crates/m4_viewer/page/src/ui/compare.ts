/**
 * The input frame beside the scene: over it with a divider while the camera is the source camera,
 * in a corner elsewhere.
 */

import type { App } from "../app";
import { PageError, toPageError } from "../errors";
import type { SourceFrames } from "../frames";
import { clamp } from "../maths";
import { control, find, make, setAttribute } from "./dom";

const INSET_PX = 240;
const INSET_NARROW_PX = 132;
const KEY_STEP = 0.02;

export class Compare {
  private readonly root = find(HTMLElement, "#compare");
  private readonly picture = find(HTMLCanvasElement, "#compare .picture");
  private readonly tag = find(HTMLElement, "#compare .tag");
  private readonly sceneTag = make("span", "tag", "Scene");
  private readonly divider = control(HTMLElement, "split");
  /** Where the divider is, share of the window. */
  private split = 0.5;
  private wanted = -1;
  private drawn = -1;

  constructor(
    private readonly app: App,
    private readonly frames: SourceFrames,
  ) {
    this.root.append(this.sceneTag);
    const move = (event: PointerEvent): void => {
      if (this.divider.hasPointerCapture(event.pointerId)) this.setSplit(event.clientX / window.innerWidth);
    };
    this.divider.addEventListener("pointerdown", (event) => this.divider.setPointerCapture(event.pointerId));
    this.divider.addEventListener("pointermove", move);
    this.divider.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (step === undefined) return;
      event.preventDefault();
      this.setSplit(this.split + step * KEY_STEP);
    });
    // an input frame changes with the image of its time, not before and not after
    app.stage.companion = async (view) => {
      if (!app.comparing) return () => undefined;
      const index = this.indexAt(view.t);
      // a frame that cannot be decoded says so itself
      const shown = await this.frames.frame(index).catch(toPageError);
      return () => {
        this.wanted = index;
        if (shown instanceof PageError) this.refuse(shown);
        else this.draw(index, shown);
      };
    };
    app.onChange(() => this.refresh());
  }

  private indexAt(t: number): number {
    return clamp(this.app.rig.path.nearestIndex(t), 0, this.frames.count - 1);
  }

  private setSplit(share: number): void {
    this.split = clamp(share, 0, 1);
    this.refresh();
  }

  refresh(): void {
    const { app } = this;
    this.root.hidden = !app.comparing;
    if (!app.comparing) return;
    this.show(this.indexAt(app.time));
    const { view } = app;
    const inset = !view?.riding;
    this.root.classList.toggle("inset", inset);
    const style = this.picture.style;
    this.sceneTag.hidden = inset;
    if (inset) {
      const width = window.innerWidth < 720 ? INSET_NARROW_PX : INSET_PX;
      style.left = style.top = "";
      style.width = `${width}px`;
      style.height = `${(width * this.frames.index.height) / this.frames.index.width}px`;
      return;
    }
    const { x, y, width, height } = view.placement;
    const at = this.split * window.innerWidth;
    style.left = `${x}px`;
    style.top = `${y}px`;
    style.width = `${width}px`;
    style.height = `${height}px`;
    style.clipPath = `inset(0 ${clamp(x + width - at, 0, width)}px 0 0)`;
    this.divider.style.left = `${at}px`;
    this.divider.style.top = `${Math.max(y, 0)}px`;
    this.divider.style.bottom = `${Math.max(window.innerHeight - y - height, 0)}px`;
    setAttribute(this.divider, "aria-valuenow", String(Math.round(100 * this.split)));
    const top = `${Math.max(y + 12, 72)}px`;
    this.tag.style.top = this.sceneTag.style.top = top;
    this.tag.style.left = `${at - this.tag.offsetWidth - 12}px`;
    this.sceneTag.style.left = `${at + 12}px`;
  }

  private draw(index: number, bitmap: ImageBitmap): void {
    // a closed image, which has no width, was asked for long ago
    if (this.drawn === index || bitmap.width === 0) return;
    this.drawn = index;
    if (this.picture.width !== bitmap.width) this.picture.width = bitmap.width;
    if (this.picture.height !== bitmap.height) this.picture.height = bitmap.height;
    this.picture.getContext("2d")?.drawImage(bitmap, 0, 0);
  }

  private refuse(error: PageError): void {
    this.tag.textContent = error.title;
    this.tag.title = error.advice;
  }

  /** Draws a frame as soon as it is decoded, unless another is wanted by then. */
  private show(index: number): void {
    if (index === this.wanted) return;
    this.wanted = index;
    this.frames.frame(index).then(
      (bitmap) => {
        if (this.wanted === index) this.draw(index, bitmap);
      },
      (error: unknown) => this.refuse(toPageError(error)),
    );
  }
}
