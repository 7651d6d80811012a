/**
 * The image: a worker chooses and sorts the splats of an instant, WebGL2 draws them.
 *
 * An image is drawn only when its own order is there, with the time and the camera that the order was made
 * for; until then the image before stays. What was asked for in between is skipped.
 */

import { breath } from "../bytes";
import type { Progress } from "../embedded";
import { PageError, toPageError } from "../errors";
import { type Manifest, colourTerms } from "../scene";
import { mostRows } from "./columns";
import { NodeTexture, OrderTexture, Program, Target, floatTexture, rectangles } from "./gl";
import { BATCH, PRESENT_FRAGMENT, PRESENT_VERTEX, SPLAT_FRAGMENT, splatVertex } from "./shaders";
import { type Returned, Splats } from "./splats";
import { type InstantCost, Timing } from "./timing";
import { type View, featherOf, lowPassOf, partOf, sameView, sliceViewOf, worldToCamera } from "./view";

/** Beyond the frame of the source camera: the dark page, in either theme. */
const OUTSIDE = [13 / 255, 14 / 255, 17 / 255] as const;
const POLL_MS = 2;
const COLUMNS = ["place", "shape", "life", "colour", "bound"] as const;
/** The samplers of the shader: the order, the nodes, then the columns. */
const SAMPLERS = ["order", "nodes", "place", "shape", "life", "colours", "bound"] as const;

/** A scene on the graphics device, and its worker. */
interface Loaded {
  readonly manifest: Manifest;
  readonly splats: Splats;
  readonly order: OrderTexture;
  readonly nodes: NodeTexture;
  readonly textures: readonly WebGLTexture[];
  readonly program: Program;
}

/** An instant whose order is there. */
interface Ready {
  readonly view: View;
  readonly loaded: Loaded;
  readonly slice: Returned;
  /** Draws what belongs beside the image. */
  readonly beside: () => void;
}

/** The splats of an instant in their order, for views from nearby. */
export type Order = Pick<Ready, "view" | "loaded" | "slice">;

/** An eye of a headset: what it sees, and where its image lies in the framebuffer, pixels from the lower left. */
export interface Eye {
  readonly view: View;
  readonly x: number;
  readonly y: number;
}

/** Whom the stage tells what. */
export interface StageHooks {
  /** An instant is there to be presented. */
  onReady(): void;
  /** The graphics device has gone. */
  onLost(): void;
  /** Nothing can be drawn any more. */
  onFailure(error: PageError): void;
}

export class Stage {
  private readonly gl: WebGL2RenderingContext;
  private readonly target: Target;
  private readonly presenting: Program;
  private readonly splatArray: WebGLVertexArrayObject;
  private readonly emptyArray: WebGLVertexArrayObject;
  private loaded: Loaded | null = null;
  private wanted: View | null = null;
  private asking = false;
  /** Counts what was called off; an order that was asked for before is not shown. */
  private calls = 0;
  private ready: Ready | null = null;
  /** The image that is shown, and of which scene. */
  private drawn: { readonly view: View; readonly active: number; readonly loaded: Loaded } | null = null;
  /** The device has not finished the image before. */
  private drawing = false;
  private lost = false;
  readonly timing = new Timing();
  /** Prepares what is shown beside an instant, such as the input frame; the result draws it. */
  companion: ((view: View) => Promise<() => void>) | null = null;

  constructor(
    readonly canvas: HTMLCanvasElement,
    private readonly hooks: StageHooks,
  ) {
    const gl = canvas.getContext("webgl2", {
      alpha: false,
      antialias: false,
      depth: false,
      stencil: false,
      preserveDrawingBuffer: true,
      powerPreference: "high-performance",
    });
    if (!gl) {
      throw new PageError(
        "This browser cannot draw the scene",
        "It has no WebGL2, or it is switched off. A current Chrome, Edge, Firefox or Safari with hardware acceleration shows it.",
      );
    }
    this.gl = gl;
    canvas.addEventListener("webglcontextlost", () => {
      this.lost = true;
      hooks.onLost();
    });
    const fine = gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float");
    this.target = new Target(gl, fine !== null);
    this.presenting = new Program(gl, PRESENT_VERTEX, PRESENT_FRAGMENT);
    this.splatArray = gl.createVertexArray();
    this.emptyArray = gl.createVertexArray();
    gl.bindVertexArray(this.splatArray);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, rectangles(BATCH), gl.STATIC_DRAW);
    gl.disable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  /** Shows another scene from its payload, packed or not; what is shown now stays until its first image. */
  async load(manifest: Manifest, bytes: Uint8Array<ArrayBuffer>, progress: Progress): Promise<void> {
    const { gl } = this;
    const rows = mostRows(manifest.splats.static + manifest.splats.dynamic, colourTerms(manifest));
    const most = Number(gl.getParameter(gl.MAX_TEXTURE_SIZE));
    if (rows > most && !this.lost) {
      throw new PageError(
        "This scene is too large for this device",
        `Its splats need ${rows} rows of a texture and the graphics driver has ${most}. Export the scene with fewer splats.`,
      );
    }
    const splats = new Splats();
    const textures: WebGLTexture[] = [];
    try {
      const { texels, nodes: count } = await splats.load(manifest, bytes, (share, doing) => progress(0.9 * share, doing));
      const program = new Program(gl, splatVertex(manifest), SPLAT_FRAGMENT);
      for (const [i, name] of COLUMNS.entries()) {
        progress(0.9 + 0.02 * i, "Preparing");
        textures.push(await floatTexture(gl, texels[name], breath));
      }
      if (gl.getError() === gl.OUT_OF_MEMORY) {
        throw new PageError(
          "The graphics device has too little memory for this scene",
          "Close other pages and reload, or export the scene with fewer splats.",
        );
      }
      const order = new OrderTexture(gl, manifest.splats.static + manifest.splats.dynamic);
      const nodes = new NodeTexture(gl, count);
      this.unload();
      this.loaded = { manifest, splats, order, nodes, textures, program };
    } catch (error) {
      splats.close();
      for (const t of textures) gl.deleteTexture(t);
      throw error;
    }
  }

  private unload(): void {
    if (!this.loaded) return;
    this.loaded.splats.close();
    this.loaded.program.dispose();
    for (const t of [this.loaded.order.texture, this.loaded.nodes.texture, ...this.loaded.textures]) this.gl.deleteTexture(t);
    this.loaded = null;
    this.ready = null;
    this.asking = false;
  }

  /** Keeps what is shown: nothing that was asked for before comes after it. */
  hold(): void {
    this.calls += 1;
    this.ready = null;
  }

  /** What is to be shown next. */
  want(view: View): void {
    this.wanted = view;
    this.pump();
  }

  /** Asks for the order of what is wanted, one at a time. */
  private pump(): void {
    const view = this.wanted;
    if (!this.loaded || this.lost || this.asking || this.ready || !view) return;
    if (this.shows(view)) return;
    const { loaded, calls } = this;
    this.asking = true;
    this.prepare(loaded, view).then(
      (ready) => {
        if (loaded !== this.loaded) return;
        this.asking = false;
        if (calls === this.calls) this.ready = ready;
        this.hooks.onReady();
      },
      (error: unknown) => {
        if (loaded === this.loaded) this.hooks.onFailure(toPageError(error));
      },
    );
  }

  private async prepare(loaded: Loaded, view: View): Promise<Ready> {
    const [slice, beside] = await Promise.all([loaded.splats.slice(sliceViewOf(view)), this.companion?.(view)]);
    return { view, loaded, slice, beside: beside ?? (() => undefined) };
  }

  /** Draws the instant that is ready, unless the device is still at the one before; true if it did. */
  present(): boolean {
    if (!this.ready || this.drawing || this.lost) return false;
    this.paint(this.ready);
    this.ready = null;
    return true;
  }

  private paint({ view, loaded, slice, beside }: Ready): void {
    const { gl, canvas } = this;
    const { lens } = view;
    const started = performance.now();
    loaded.order.set(slice.ids);
    loaded.nodes.set(slice.nodes);
    const uploaded = performance.now();

    if (canvas.width !== lens.width) canvas.width = lens.width;
    if (canvas.height !== lens.height) canvas.height = lens.height;
    this.target.bind(lens.width, lens.height);
    gl.viewport(0, 0, lens.width, lens.height);
    gl.clearColor(...loaded.manifest.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    this.drawSplats(view, loaded, slice.count);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.showThrough(view, loaded, [0, 0]);
    beside();
    this.drawn = { view, active: slice.count, loaded };
    const before = { slice: slice.sliceMs, readback: slice.wayMs + uploaded - started, sort: slice.sortMs };
    void this.finish(before, uploaded);
  }

  private drawSplats(view: View, { manifest, order, nodes, textures, program }: Loaded, count: number): void {
    if (count === 0) return;
    const { gl } = this;
    const { lens, pose } = view;
    const [left, top, right, bottom] = partOf(view);
    const m = worldToCamera(pose);
    program.use();
    [order.texture, nodes.texture, ...textures].forEach((t, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, t);
      gl.uniform1i(program.at(SAMPLERS[unit] ?? ""), unit);
    });
    gl.uniform1i(program.at("dynamicFrom"), manifest.splats.static);
    gl.uniform1i(program.at("freeFrom"), manifest.splats.static + manifest.splats.bound);
    gl.uniform1f(program.at("time"), view.t);
    gl.uniform3f(program.at("eye"), ...pose.position);
    gl.uniformMatrix4fv(program.at("view"), true, [...m, 0, 0, 0, 1]);
    gl.uniform4f(program.at("lens"), lens.fx, lens.fy, lens.cx, lens.cy);
    gl.uniform2f(program.at("size"), lens.width, lens.height);
    gl.uniform1f(program.at("near"), manifest.near);
    gl.uniform1f(program.at("lowPass"), lowPassOf(view));
    gl.uniform1i(program.at("mip"), manifest.mip ? 1 : 0);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(left, lens.height - bottom, Math.max(0, right - left), Math.max(0, bottom - top));
    gl.enable(gl.BLEND);
    gl.bindVertexArray(this.splatArray);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * BATCH, gl.UNSIGNED_SHORT, 0, Math.ceil(count / BATCH));
    gl.disable(gl.BLEND);
    gl.disable(gl.SCISSOR_TEST);
  }

  /** The image to the screen. */
  private showThrough(view: View, { manifest }: Loaded, [x, y]: readonly [number, number]): void {
    const { gl, presenting } = this;
    const { frame, lens } = view;
    presenting.use();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.target.image);
    gl.uniform1i(presenting.at("image"), 0);
    gl.uniform3f(presenting.at("fadeTo"), ...manifest.background);
    gl.uniform2f(presenting.at("origin"), x, y);
    gl.uniform1f(presenting.at("fade"), view.fade);
    gl.uniform1f(presenting.at("feather"), featherOf(view));
    gl.uniform3f(presenting.at("outside"), ...OUTSIDE);
    if (frame) {
      const low = lens.height - frame.y - frame.height;
      gl.uniform4f(presenting.at("frame"), frame.x, low, frame.x + frame.width, low + frame.height);
    }
    gl.bindVertexArray(this.emptyArray);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** A layer that a headset shows. */
  async headsetLayer(session: XRSession): Promise<XRWebGLLayer> {
    await this.gl.makeXRCompatible();
    return new XRWebGLLayer(session, this.gl, { antialias: false, depth: false, stencil: false, alpha: false });
  }

  /** The splats of a view in their order; none where another scene comes or the device has gone. */
  async order(view: View): Promise<Order | null> {
    const { loaded } = this;
    if (!loaded || this.lost) return null;
    try {
      return { view, loaded, slice: await loaded.splats.slice(sliceViewOf(view)) };
    } catch (error) {
      if (loaded !== this.loaded) return null;
      throw error;
    }
  }

  /** Draws an order as both eyes of a headset see it. */
  drawEyes({ view, loaded, slice }: Order, eyes: readonly Eye[], framebuffer: WebGLFramebuffer | null): void {
    if (this.lost || loaded !== this.loaded) return;
    const { gl } = this;
    if (this.drawn?.view !== view) {
      loaded.order.set(slice.ids);
      loaded.nodes.set(slice.nodes);
      this.drawn = { view, active: slice.count, loaded };
    }
    for (const { view: seen, x, y } of eyes) {
      const { width, height } = seen.lens;
      // splats move with the time of their order
      const eye = { ...seen, t: view.t };
      this.target.bind(width, height);
      gl.viewport(0, 0, width, height);
      gl.clearColor(...loaded.manifest.background, 1);
      gl.clear(gl.COLOR_BUFFER_BIT);
      this.drawSplats(eye, loaded, slice.count);
      gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
      gl.viewport(x, y, width, height);
      this.showThrough(eye, loaded, [x, y]);
    }
  }

  /** Waits until the device has drawn the image, and notes what it cost. */
  private async finish(before: Omit<InstantCost, "draw">, started: number): Promise<void> {
    const { gl } = this;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    this.drawing = true;
    const waiting = (): boolean =>
      fence !== null && !this.lost && gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.UNSIGNALED;
    do await new Promise((resolve) => setTimeout(resolve, POLL_MS));
    while (waiting());
    gl.deleteSync(fence);
    this.drawing = false;
    const now = performance.now();
    this.timing.push({ ...before, draw: now - started }, now);
    if (this.ready) this.hooks.onReady();
  }

  /** Whether what is wanted is what is shown, in its order. */
  get sorted(): boolean {
    return !this.loaded || !this.wanted || this.shows(this.wanted);
  }

  private shows(view: View): boolean {
    return this.drawn !== null && this.drawn.loaded === this.loaded && sameView(this.drawn.view, view);
  }

  /** The image that is shown; none before the first one. */
  get shown(): View | null {
    return this.drawn?.view ?? null;
  }

  /** How many splats take part in the image. */
  get active(): number {
    return this.drawn?.active ?? 0;
  }

  /** Draws this view and nothing else, as soon as its order is there. */
  async settle(view: View): Promise<void> {
    this.wanted = view;
    for (;;) {
      const { loaded } = this;
      if (!loaded || this.lost) return;
      try {
        const ready = await this.prepare(loaded, view);
        if (loaded !== this.loaded || this.lost) continue;
        this.ready = null;
        this.paint(ready);
        return;
      } catch (error) {
        // another scene took its place meanwhile: that one is shown then
        if (loaded === this.loaded) throw error;
      }
    }
  }
}
