/** The picture: WebGL2, Spark for slicing and sorting, our shaders for drawing. */

import { SparkRenderer } from "@sparkjsdev/spark";
import {
  Camera,
  Color,
  ColorManagement,
  GLSL3,
  HalfFloatType,
  LinearSRGBColorSpace,
  Matrix4,
  Mesh,
  NearestFilter,
  NoBlending,
  PlaneGeometry,
  RGBAFormat,
  Scene,
  ShaderMaterial,
  UnsignedByteType,
  Vector2,
  Vector3,
  Vector4,
  WebGLRenderTarget,
  WebGLRenderer,
} from "three";
import type { Lens } from "../camera/path";
import type { Placement } from "../camera/view";
import { PageError } from "../errors";
import { type Pose, matrixOf } from "../maths";
import { type Manifest, type SceneData, colourTerms, splatCount } from "../scene";
import { type Instant, instantOf } from "./generator";
import { LOW_PASS, PRESENT_FRAGMENT, PRESENT_VERTEX, SPLAT_FRAGMENT, SPLAT_VERTEX } from "./shaders";
import { type SplatTextures, disposeTextures, splatTextures } from "./textures";

/** All that decides the picture. */
export interface View {
  readonly t: number;
  readonly pose: Pose;
  /** For the whole of the canvas, its pixels. */
  readonly lens: Lens;
  /** Focal length of the training over that of the lens; the filter grows with the picture. */
  readonly magnification: number;
  /** 0..1: how much of the picture is gone. */
  readonly fade: number;
  /** The frame of the source camera, pixels of the canvas; what lies further out is not shown. */
  readonly frame: Placement | null;
}

/** Beyond the frame of the source camera: the dark page, in either theme. */
const OUTSIDE = [13 / 255, 14 / 255, 17 / 255] as const;
/** How softly the picture ends there, as a share of the shorter side of the frame. */
const FEATHER = 0.08;
const SORT_TIMEOUT_MS = 60_000;
const POLL_MS = 4;

// sRGB values go through as they are: the scene was trained on them
ColorManagement.enabled = false;

interface Loaded {
  readonly manifest: Manifest;
  readonly empty: boolean;
  readonly instant: Instant;
  readonly textures: SplatTextures;
}

export class Stage {
  private readonly renderer: WebGLRenderer;
  private readonly spark: SparkRenderer;
  private readonly scene = new Scene();
  private readonly camera = new Camera();
  private readonly target: WebGLRenderTarget;
  private readonly present: Mesh<PlaneGeometry, ShaderMaterial>;
  private readonly presentScene = new Scene();
  private readonly uniforms = {
    m4Shape: { value: null as unknown },
    m4View: { value: new Matrix4() },
    m4Lens: { value: new Vector4() },
    m4Size: { value: new Vector2() },
    m4Near: { value: 0 },
    m4LowPass: { value: LOW_PASS },
    m4Mip: { value: false },
  };
  /** What Spark slices and sorts, and what the shaders draw; they differ while a new scene is sorted first. */
  private loaded: Loaded | null = null;
  private bound: Loaded | null = null;
  /** Spark's own word that something changed is no news while it is being told so. */
  private slicing = false;
  /** An update came while Spark could not take it. */
  private stale = false;
  private readonly background = new Color(0, 0, 0);
  private shown: View | null = null;
  private lost = false;

  constructor(
    readonly canvas: HTMLCanvasElement,
    /** A better order or a first picture is there to be drawn. */
    onDirty: () => void,
    onLost: () => void,
  ) {
    const context = canvas.getContext("webgl2", {
      alpha: false,
      antialias: false,
      depth: false,
      stencil: false,
      preserveDrawingBuffer: true,
      powerPreference: "high-performance",
    });
    if (!context) {
      throw new PageError(
        "This browser cannot draw the scene",
        "It has no WebGL2, or it is switched off. A current Chrome, Edge, Firefox or Safari with hardware acceleration shows it.",
      );
    }
    canvas.addEventListener("webglcontextlost", () => {
      this.lost = true;
      onLost();
    });
    this.renderer = new WebGLRenderer({ canvas, context });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.autoClear = false;
    this.camera.matrixAutoUpdate = false;

    const fine = context.getExtension("EXT_color_buffer_float") ?? context.getExtension("EXT_color_buffer_half_float");
    this.target = new WebGLRenderTarget(1, 1, {
      format: RGBAFormat,
      type: fine ? HalfFloatType : UnsignedByteType,
      minFilter: NearestFilter,
      magFilter: NearestFilter,
      depthBuffer: false,
      stencilBuffer: false,
    });
    this.spark = new SparkRenderer({
      renderer: this.renderer,
      autoUpdate: false,
      accumExtSplats: true,
      enableLod: false,
      sortRadial: false,
      depthTest: false,
      vertexShader: SPLAT_VERTEX,
      fragmentShader: SPLAT_FRAGMENT,
      extraUniforms: this.uniforms,
      onDirty: () => {
        if (!this.slicing) onDirty();
      },
    });
    this.scene.add(this.spark);
    this.present = new Mesh(
      new PlaneGeometry(2, 2),
      new ShaderMaterial({
        glslVersion: GLSL3,
        vertexShader: PRESENT_VERTEX,
        fragmentShader: PRESENT_FRAGMENT,
        uniforms: {
          picture: { value: this.target.texture },
          fadeTo: { value: new Vector3() },
          fade: { value: 0 },
          frame: { value: new Vector4() },
          feather: { value: 0 },
          outside: { value: new Vector3(...OUTSIDE) },
        },
        blending: NoBlending,
        depthTest: false,
        depthWrite: false,
      }),
    );
    this.present.frustumCulled = false;
    this.presentScene.add(this.present);
  }

  /** Shows another scene, as soon as it is sorted; what is shown now stays until then. */
  load(manifest: Manifest, data: SceneData): void {
    const most = this.renderer.capabilities.maxTextureSize;
    const textures = splatTextures(data, colourTerms(manifest), most);
    const instant = instantOf(manifest, data, textures);
    if (this.loaded) {
      this.scene.remove(this.loaded.instant.splats);
      if (this.loaded !== this.bound) disposeTextures(this.loaded.textures);
    }
    this.loaded = { manifest, empty: splatCount(data) === 0, instant, textures };
    this.scene.add(instant.splats);
    this.shown = null;
    if (!this.bound || this.loaded.empty) this.bind(this.loaded);
  }

  private bind(next: Loaded): void {
    if (this.bound && this.bound !== next) disposeTextures(this.bound.textures);
    this.bound = next;
    const { manifest, textures } = next;
    this.background.setRGB(...manifest.background);
    this.uniforms.m4Shape.value = textures.shape;
    this.uniforms.m4Near.value = manifest.near;
    this.uniforms.m4Mip.value = manifest.mip;
    const fadeTo = this.present.material.uniforms["fadeTo"];
    if (fadeTo) fadeTo.value = new Vector3(...manifest.background);
    this.spark.visible = !next.empty;
  }

  /** Size of the canvas in its own pixels. */
  resize(width: number, height: number): void {
    if (this.canvas.width === width && this.canvas.height === height) return;
    this.renderer.setSize(width, height, false);
    this.target.setSize(width, height);
  }

  /** Draws with the order there is; a better one follows by itself and calls `onDirty`. */
  draw(view: View): void {
    this.slice(view);
    this.paint(view);
  }

  /** Splats to their places at the view's time, and the sort on its way. */
  private slice(view: View): void {
    if (!this.loaded || this.lost) return;
    const moved = this.stale || !this.shown || !sameSplats(this.shown, view);
    this.shown = view;
    const m = matrixOf(view.pose);
    this.camera.matrix.set(
      m[0] ?? 1, -(m[1] ?? 0), -(m[2] ?? 0), m[3] ?? 0,
      m[4] ?? 0, -(m[5] ?? 1), -(m[6] ?? 0), m[7] ?? 0,
      m[8] ?? 0, -(m[9] ?? 0), -(m[10] ?? 1), m[11] ?? 0,
      0, 0, 0, 1,
    );
    this.camera.updateMatrixWorld(true);
    if (!moved || this.loaded.empty) return;
    // while a first order of a new scene is on its way Spark takes nothing else
    this.stale = this.spark.sorting && !this.displayed;
    this.loaded.instant.set(view.t, view.pose.position);
    this.slicing = true;
    // the sort goes on in a worker; what fails there shows as an error of the page
    void this.spark.update({ scene: this.scene, camera: this.camera });
    this.slicing = false;
  }

  private paint(view: View): void {
    if (!this.loaded || this.lost) return;
    const m = matrixOf(view.pose);
    this.uniforms.m4View.value.set(
      m[0] ?? 1, m[1] ?? 0, m[2] ?? 0, m[3] ?? 0,
      m[4] ?? 0, m[5] ?? 1, m[6] ?? 0, m[7] ?? 0,
      m[8] ?? 0, m[9] ?? 0, m[10] ?? 1, m[11] ?? 0,
      0, 0, 0, 1,
    ).invert();
    const { lens } = view;
    this.uniforms.m4Lens.value.set(lens.fx, lens.fy, lens.cx, lens.cy);
    this.uniforms.m4Size.value.set(lens.width, lens.height);
    this.uniforms.m4LowPass.value = LOW_PASS * Math.max(view.magnification, 1) ** 2;
    if (this.bound !== this.loaded && this.displayed) this.bind(this.loaded);
    this.renderer.setRenderTarget(this.target);
    this.renderer.setClearColor(this.background, 1);
    this.renderer.clear(true, false, false);
    this.renderer.render(this.scene, this.camera);
    this.renderer.setRenderTarget(null);
    this.showThrough(view);
    this.renderer.render(this.presentScene, this.camera);
  }

  private showThrough({ fade, frame, lens }: View): void {
    const uniforms = this.present.material.uniforms;
    const set = (name: string, value: number): void => {
      const uniform = uniforms[name];
      if (uniform) uniform.value = value;
    };
    set("fade", fade);
    set("feather", frame ? FEATHER * Math.min(frame.width, frame.height) : 0);
    const rectangle: unknown = uniforms["frame"]?.value;
    if (frame && rectangle instanceof Vector4) {
      const bottom = lens.height - frame.y - frame.height;
      rectangle.set(frame.x, bottom, frame.x + frame.width, bottom + frame.height);
    }
  }

  /** Whether what Spark shows is the scene that was loaded last. */
  private get displayed(): boolean {
    const splats = this.loaded?.instant.splats;
    return this.spark.display.mapping.some((m) => m.node === splats);
  }

  /** Whether the picture is drawn in the order of the splats as they are now. */
  get sorted(): boolean {
    if (!this.loaded || this.loaded.empty) return true;
    const s = this.spark;
    return !s.sorting && !s.sortDirty && !this.stale && this.displayed && s.orderingTexture !== null;
  }

  /** How many splats take part in the picture. */
  get active(): number {
    return this.spark.activeSplats;
  }

  /** Draws until the order is that of the splats as they are. */
  async settle(view: View): Promise<void> {
    this.slice(view);
    const started = performance.now();
    while (!this.sorted) {
      if (this.lost) return;
      if (performance.now() - started > SORT_TIMEOUT_MS) {
        throw new PageError("Sorting the splats takes too long", "The worker did not answer within a minute. Reload the page.");
      }
      await new Promise((resolve) => setTimeout(resolve, POLL_MS));
      if (this.stale) this.slice(view);
    }
    this.paint(view);
  }
}

/** Whether splats, their colours and their order are the same in two views. */
function sameSplats(a: View, b: View): boolean {
  return (
    a.t === b.t &&
    a.pose.position.every((v, i) => v === b.pose.position[i]) &&
    a.pose.rotation.every((v, i) => v === b.pose.rotation[i])
  );
}
