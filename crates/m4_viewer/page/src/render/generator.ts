/**
 * Splats at an instant, on the GPU: Spark runs this for every splat, sorts by the depth of `center`
 * and hands place, opacity and colour on to the shaders of [splat.glsl].
 */

import { SplatGenerator, dyno } from "@sparkjsdev/spark";
import { type DataTexture, Vector3 } from "three";
import { type Manifest, type SceneData, shTerms, splatCount } from "../scene";
import { shadeStatements } from "./shade";
import { type SplatTextures, fetchTexel } from "./textures";

/** A splat with less of its opacity left at an instant is not there (as the renderer of the training). */
const MARGINAL_MIN = 0.05;

/** What changes from frame to frame. */
export interface Instant {
  readonly splats: SplatGenerator;
  /** `t` in frames, the camera's centre in the world. */
  set(t: number, centre: readonly [number, number, number]): void;
}

const sampler = (key: string, value: DataTexture): dyno.DynoSampler2D<string, DataTexture> =>
  new dyno.DynoSampler2D({ key, value });

export function instantOf(manifest: Manifest, data: SceneData, textures: SplatTextures): Instant {
  // the columns themselves are not kept
  const { nStatic } = data;
  const numSplats = splatCount(data);
  const time = new dyno.DynoFloat({ key: "m4Time", value: 0 });
  const eye = new dyno.DynoVec3({ key: "m4Eye", value: new Vector3() });
  const inputs = {
    time,
    eye,
    place: sampler("m4Place", textures.place),
    shape: sampler("m4Shape", textures.shape),
    life: sampler("m4Life", textures.life),
    colours: sampler("m4Colour", textures.colour),
  };
  const shading = (texture: string): string[] =>
    shadeStatements(texture, shTerms(manifest), manifest.splats.time_degree + 1);
  const generator = dyno.dynoBlock({ index: "int" }, { gsplat: dyno.Gsplat }, ({ index }) => {
    if (!index) return undefined;
    const slice = dyno.dyno({
      inTypes: {
        index: "int",
        time: "float",
        eye: "vec3",
        place: "sampler2D",
        shape: "sampler2D",
        life: "sampler2D",
        colours: "sampler2D",
      },
      outTypes: { gsplat: dyno.Gsplat },
      inputs: { index, ...inputs },
      globals: () => [dyno.defineGsplat],
      statements: ({ inputs: i, outputs: { gsplat } }) => [
        "{",
        `int index = ${i.index};`,
        `vec4 placed = ${fetchTexel(i.place ?? "", "index")};`,
        "vec3 mean = placed.xyz;",
        "float marginal = 1.0;",
        "float turns = 0.0;",
        `if (index >= ${nStatic}) {`,
        `  vec4 life = ${fetchTexel(i.life ?? "", `index - ${nStatic}`)};`,
        `  float third = ${fetchTexel(i.shape ?? "", "2 * index")}.w;`,
        `  float dt = ${i.time} - life.x;`,
        "  float r = dt / life.y;",
        "  mean += dt * vec3(life.zw, third);",
        "  marginal = exp(-0.5 * r * r);",
        `  turns = dt * ${(1 / manifest.period_frames).toPrecision(10)};`,
        "}",
        `vec3 toSplat = normalize(mean - ${i.eye});`,
        ...shading(i.colours ?? ""),
        `${gsplat}.flags = marginal > ${MARGINAL_MIN.toPrecision(10)} ? GSPLAT_FLAG_ACTIVE : 0u;`,
        `${gsplat}.index = index;`,
        `${gsplat}.center = mean;`,
        `${gsplat}.scales = vec3(1.0);`,
        `${gsplat}.quaternion = vec4(0.0, 0.0, 0.0, 1.0);`,
        `${gsplat}.rgba = vec4(colour, placed.w * marginal);`,
        "}",
      ],
    });
    return { gsplat: slice.outputs.gsplat };
  });
  const splats = new SplatGenerator({ numSplats, generator });
  return {
    splats,
    set(t, centre) {
      time.value = t;
      eye.value.set(...centre);
      splats.updateVersion();
    },
  };
}
