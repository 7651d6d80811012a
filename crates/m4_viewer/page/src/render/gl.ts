/** The few things of WebGL2 that the page needs. */

import { PageError } from "../errors";
import { ROW, rowsOf } from "./columns";

/** Rows that are handed over before the page may paint. */
const BAND = 256;

/** A program with its uniforms; throws what the driver says of a shader that it refuses. */
export class Program {
  private readonly program: WebGLProgram;
  private readonly places = new Map<string, WebGLUniformLocation | null>();

  constructor(
    private readonly gl: WebGL2RenderingContext,
    vertex: string,
    fragment: string,
  ) {
    this.program = gl.createProgram();
    const shaders = [
      [gl.VERTEX_SHADER, vertex],
      [gl.FRAGMENT_SHADER, fragment],
    ] as const;
    const made = shaders.map(([kind, source]) => {
      const shader = gl.createShader(kind);
      if (!shader) throw this.refused("no shader");
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
      return shader;
    });
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw this.refused(made.map((s) => gl.getShaderInfoLog(s) ?? "").join(" ") + (gl.getProgramInfoLog(this.program) ?? ""));
    }
    made.forEach((shader) => gl.deleteShader(shader));
  }

  private refused(why: string): PageError {
    return new PageError(
      "The graphics driver refuses the page",
      `It cannot build a shader: ${why.trim().slice(0, 300) || "it does not say why"}. Another browser, or a newer driver, may show the scene.`,
    );
  }

  use(): void {
    this.gl.useProgram(this.program);
  }

  /** Where a uniform is; `null` where the shader does not use it. */
  at(name: string): WebGLUniformLocation | null {
    let place = this.places.get(name);
    if (place === undefined) {
      place = this.gl.getUniformLocation(this.program, name);
      this.places.set(name, place);
    }
    return place;
  }

  dispose(): void {
    this.gl.deleteProgram(this.program);
  }
}

/** A texture whose texels are fetched one by one. */
function texture(gl: WebGL2RenderingContext): WebGLTexture {
  const out = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, out);
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
  for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
  return out;
}

/** Rows of float texels as a texture; `breath` is waited for between parts of it. */
export async function floatTexture(
  gl: WebGL2RenderingContext,
  texels: Float32Array,
  breath: () => Promise<void>,
): Promise<WebGLTexture> {
  const rows = rowsOf(texels.length / 4);
  const out = texture(gl);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, ROW, rows);
  for (let row = 0; row < rows; row += BAND) {
    const count = Math.min(BAND, rows - row);
    const part = texels.subarray(4 * ROW * row, 4 * ROW * (row + count));
    gl.bindTexture(gl.TEXTURE_2D, out);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, ROW, count, gl.RGBA, gl.FLOAT, part);
    await breath();
  }
  return out;
}

/** The order of an instant as a texture of whole numbers. */
export class OrderTexture {
  readonly texture: WebGLTexture;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    /** Most splats of an order. */
    most: number,
  ) {
    this.texture = texture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R32UI, ROW, rowsOf(most));
  }

  /** Takes an order of whole rows. */
  set(ids: Uint32Array): void {
    const { gl } = this;
    const rows = ids.length / ROW;
    if (rows === 0) return;
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, ROW, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, ids);
  }
}

/** The nodes of an instant as a texture. */
export class NodeTexture {
  readonly texture: WebGLTexture;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    /** Of whole rows. */
    texels: number,
  ) {
    this.texture = texture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, ROW, rowsOf(texels));
  }

  /** Takes whole rows. */
  set(texels: Float32Array): void {
    const { gl } = this;
    const rows = texels.length / (4 * ROW);
    if (rows === 0) return;
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, ROW, rows, gl.RGBA, gl.FLOAT, texels);
  }
}

/** Vertices of so many rectangles, as two triangles each. */
export function rectangles(count: number): Uint16Array {
  const out = new Uint16Array(6 * count);
  for (let i = 0; i < count; i++) out.set([0, 1, 2, 2, 1, 3].map((v) => 4 * i + v), 6 * i);
  return out;
}

/** Where splats are blended: half floats where the device can, else bytes. */
export class Target {
  private readonly framebuffer: WebGLFramebuffer;
  private texture: WebGLTexture | null = null;
  private width = 0;
  private height = 0;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly fine: boolean,
  ) {
    this.framebuffer = gl.createFramebuffer();
  }

  /** Draws go here from now on. */
  bind(width: number, height: number): void {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    if (this.width === width && this.height === height) return;
    gl.deleteTexture(this.texture);
    this.texture = texture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, this.fine ? gl.RGBA16F : gl.RGBA8, width, height);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.texture, 0);
    [this.width, this.height] = [width, height];
  }

  get image(): WebGLTexture | null {
    return this.texture;
  }
}
