/**
 * The scene in a headset (WebXR).
 *
 * Both eyes are drawn for every image of the headset, from where they are at that moment, with the latest order that
 * the worker has made: the order, and the time of the scene with it, is a few images old at most.
 */

import type { App } from "../app";
import { type Pose, distance } from "../maths";
import type { Order } from "../render/stage";
import type { View } from "../render/view";
import { control, setAttribute } from "../ui/dom";
import { toast } from "../ui/notices";
import { type Anchor, anchorAt, inScene, lensOfProjection, orderLens, poseOfHeadset } from "./eyes";

/** Most splats of an instant: what the device of a headset draws twice within an image. */
const MOST_SPLATS = 200_000;
/** How far in front of the viewer the middle of the scene begins, metres: scenes have no unit. */
const DISTANCE_M = 2;
/** Longest step of time that is taken at once, seconds. */
const STEP_MOST_S = 0.2;

/** Offers the headset where the browser has one. */
export async function offerHeadset(app: App): Promise<void> {
  const button = control(HTMLButtonElement, "headset");
  const { xr } = navigator;
  if (!xr || !(await xr.isSessionSupported("immersive-vr").catch(() => false))) return;
  button.hidden = false;
  let worn: Worn | null = null;
  button.addEventListener("click", () => {
    if (worn) {
      worn.end();
      return;
    }
    const { active } = app.stage;
    if (active > MOST_SPLATS) {
      toast(`${active.toLocaleString("en")} splats at a time are too many for a headset: it draws ${MOST_SPLATS.toLocaleString("en")}`);
      return;
    }
    Worn.start(app, xr, () => {
      worn = null;
      setAttribute(button, "aria-pressed", "false");
    }).then(
      (started) => {
        worn = started;
        setAttribute(button, "aria-pressed", "true");
      },
      (error: unknown) => toast(`The headset did not start: ${error instanceof Error ? error.message : String(error)}`),
    );
  });
}

/** A headset that shows the scene. */
class Worn {
  private anchor: Anchor | null = null;
  private order: Order | null = null;
  private asking = false;
  private last: number | null = null;

  private constructor(
    private readonly app: App,
    private readonly session: XRSession,
    private readonly layer: XRWebGLLayer,
    private readonly space: XRReferenceSpace,
  ) {}

  static async start(app: App, xr: XRSystem, ended: () => void): Promise<Worn> {
    const session = await xr.requestSession("immersive-vr");
    try {
      const layer = await app.stage.headsetLayer(session);
      await session.updateRenderState({ baseLayer: layer });
      const worn = new Worn(app, session, layer, await session.requestReferenceSpace("local"));
      app.worn = true;
      session.addEventListener("select", () => app.togglePlay());
      session.addEventListener("end", () => {
        app.worn = false;
        ended();
        app.invalidate();
      });
      session.requestAnimationFrame(worn.draw);
      return worn;
    } catch (error) {
      await session.end().catch(() => undefined);
      throw error;
    }
  }

  end(): void {
    void this.session.end();
  }

  private readonly draw = (now: number, frame: XRFrame): void => {
    this.session.requestAnimationFrame(this.draw);
    const passed = this.last === null ? 0 : Math.max(now - this.last, 0) / 1000;
    this.last = now;
    this.app.clock.advance(Math.min(passed, STEP_MOST_S));
    const viewer = frame.getViewerPose(this.space);
    if (!viewer) return;
    const seen = poseOfHeadset(viewer.transform.matrix);
    this.anchor ??= this.anchorFor(seen);
    const head = this.view(inScene(this.anchor, seen));
    this.ask(head);
    if (!this.order) return;
    const { anchor } = this;
    const eyes = viewer.views.flatMap((eye) => {
      const port = this.layer.getViewport(eye);
      if (!port || port.width < 1 || port.height < 1) return [];
      const lens = lensOfProjection(eye.projectionMatrix, port.width, port.height);
      const pose = inScene(anchor, poseOfHeadset(eye.transform.matrix));
      return [{ x: port.x, y: port.y, view: { ...head, pose, lens, magnification: this.magnification(lens.fx) } }];
    });
    this.app.stage.drawEyes(this.order, eyes, this.layer.framebuffer);
  };

  private anchorFor(seen: Pose): Anchor {
    const { rig, clock, manifest } = this.app;
    const camera = rig.at(clock.time);
    return anchorAt(camera, rig.path.up, seen, distance(camera.position, manifest.centre) / DISTANCE_M || 1);
  }

  private magnification(fx: number): number {
    return fx / this.app.rig.path.lens(this.app.clock.time).fx;
  }

  /** What is ordered: everything about the head. */
  private view(pose: Pose): View {
    const lens = orderLens();
    const { rig, clock } = this.app;
    return {
      t: clock.time,
      pose,
      lens,
      magnification: 1,
      // heads cannot be drawn back, and there is nothing to lift the limit of moving parts with
      fade: rig.safe.fade(pose.position, null),
      frame: null,
      placement: { x: 0, y: 0, width: lens.width, height: lens.height },
      riding: false,
    };
  }

  /** Asks for the order of a view, one at a time. */
  private ask(view: View): void {
    if (this.asking) return;
    this.asking = true;
    this.app.stage.order(view).then(
      (order) => {
        this.order = order ?? this.order;
        this.asking = false;
      },
      () => this.end(),
    );
  }
}
