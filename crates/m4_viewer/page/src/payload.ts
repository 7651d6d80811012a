// The splats of a scene from the bytes that the program wrote into the page: the other side of
// crates/m4_viewer/src/payload/mod.rs, which describes them byte for byte.

import { readBound, readBoundHeader } from "./bound";
import { Planes, damaged } from "./planes";
import { type Manifest, NOTHING_BOUND, type SceneData } from "./scene";

const HEADER_BYTES = 136;
/** Without and with bound splats. */
const VERSIONS = [1, 2];
const MAGIC = "M4SP";
const OPAQUE = 1 - 1 / 2048;
const MIDDLE_24 = 2 ** 23;
const MIDDLE_16 = 2 ** 15;

/**
 * The splats in `bytes` (without gzip), which must be as many as `manifest` says.
 *
 * @throws PageError if the bytes are of another kind, version or length.
 */
export function decodePayload(bytes: Uint8Array, manifest: Pick<Manifest, "splats">): SceneData {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (bytes.length < HEADER_BYTES || String.fromCharCode(...bytes.subarray(0, 4)) !== MAGIC) {
    throw damaged(`these ${bytes.length} bytes do not begin with the header of a minute4d page`);
  }
  const version = view.getUint32(4, true);
  if (!VERSIONS.includes(version)) {
    throw damaged(`the splats are of version ${version}, this page reads versions ${VERSIONS.join(" and ")}`);
  }
  const header = version === 2 ? readBoundHeader(view) : null;
  const nBound = header?.count ?? 0;
  const nStatic = view.getUint32(8, true);
  const nDynamic = view.getUint32(12, true);
  const shDegree = view.getUint8(16);
  const timeDegree = view.getUint8(17);
  const isotropic = view.getUint8(18) === 1;
  const told = manifest.splats;
  if (
    told.static !== nStatic ||
    told.dynamic !== nDynamic ||
    told.bound !== nBound ||
    told.sh_degree !== shDegree ||
    told.time_degree !== timeDegree ||
    told.isotropic !== isotropic
  ) {
    throw damaged("the splats are not those that the manifest describes");
  }
  if (nBound > nDynamic) throw damaged(`${nBound} bound splats are named, and ${nDynamic} are dynamic`);
  const n = nStatic + nDynamic;
  const nFree = nDynamic - nBound;
  const colours = 3 * (shDegree + 1) ** 2 * (timeDegree + 1);
  const shared = isotropic ? 3 * 3 + 1 + 1 + 2 * colours : 3 * 3 + 3 + 4 + 1 + 2 * colours;
  const expected = (header?.end ?? HEADER_BYTES) + n * shared + nFree * (2 + 1 + 3 * 2) + (header?.bytes ?? 0);
  if (bytes.length !== expected) {
    throw damaged(`${expected} bytes of splats were expected, and ${bytes.length} were found`);
  }
  const number = (index: number): number => view.getFloat64(24 + 8 * index, true);
  const planes = new Planes(bytes, header?.end ?? HEADER_BYTES);

  const meanSpread = number(3);
  const meanStep = number(4);
  const place = (k: number, q: number): number => number(k) + meanSpread * Math.sinh(meanStep * (q - MIDDLE_24));
  const mean = new Float32Array(3 * n);
  for (let k = 0; k < 3; k++) {
    const q = planes.next(3, n);
    for (let i = 0; i < n; i++) mean[3 * i + k] = place(k, q(i));
  }

  // a byte has few values: exponentials are looked up
  const table = (low: number, step: number): Float32Array =>
    Float32Array.from({ length: 256 }, (_, q) => Math.exp(low + step * q));
  const scale = new Float32Array(3 * n);
  const sizes = table(number(5), number(6));
  if (isotropic) {
    const q = planes.next(1, n);
    for (let i = 0; i < n; i++) scale.fill(sizes[q(i)] as number, 3 * i, 3 * i + 3);
  } else {
    for (let k = 0; k < 3; k++) {
      const q = planes.next(1, n);
      for (let i = 0; i < n; i++) scale[3 * i + k] = sizes[q(i)] as number;
    }
  }

  const quat = new Float32Array(4 * n);
  if (isotropic) {
    for (let i = 0; i < n; i++) quat[4 * i] = 1;
  } else {
    readRotations(planes.next(4, n), quat, n);
  }

  const opacity = new Float32Array(n);
  const opacityCode = planes.next(1, n);
  for (let i = 0; i < n; i++) {
    // what fades in optical depth is never quite opaque
    const most = i >= nStatic && i < nStatic + nBound ? OPAQUE : 1;
    opacity[i] = Math.min(opacityCode(i) / 255, most);
  }

  const colourStep = number(7);
  const colour = new Float32Array(colours * n);
  for (let k = 0; k < colours; k++) {
    const q = planes.next(2, n);
    for (let i = 0; i < n; i++) colour[colours * i + k] = colourStep * (q(i) - MIDDLE_16);
  }

  const timeMean = new Float32Array(nFree);
  const timeLow = number(8);
  const timeStep = number(9);
  const timeCode = planes.next(2, nFree);
  for (let i = 0; i < nFree; i++) timeMean[i] = timeLow + timeStep * timeCode(i);

  const timeSd = new Float32Array(nFree);
  const lives = table(number(10), number(11));
  const sdCode = planes.next(1, nFree);
  for (let i = 0; i < nFree; i++) timeSd[i] = lives[sdCode(i)] as number;

  const velocity = new Float32Array(3 * nFree);
  const velocitySpread = number(12);
  const velocityStep = number(13);
  for (let k = 0; k < 3; k++) {
    const q = planes.next(2, nFree);
    for (let i = 0; i < nFree; i++) {
      velocity[3 * i + k] = velocitySpread * Math.sinh(velocityStep * (q(i) - MIDDLE_16));
    }
  }
  const bound = header ? readBound(planes, header, place) : NOTHING_BOUND;
  if (planes.end !== bytes.length) throw damaged("the splats end before their last column");
  return { nStatic, nBound, nFree, mean, scale, quat, opacity, colour, bound, timeMean, timeSd, velocity };
}

/** Smallest three components of 10 bits each; the upper two bits name the one that was left out. */
function readRotations(q: (row: number) => number, quat: Float32Array, n: number): void {
  const values = Float64Array.from({ length: 1024 }, (_, v) => ((v / 1023) * 2 - 1) * Math.SQRT1_2);
  for (let i = 0; i < n; i++) {
    const bits = q(i);
    const largest = bits >>> 30;
    const a = values[bits & 1023] as number;
    const b = values[(bits >>> 10) & 1023] as number;
    const c = values[(bits >>> 20) & 1023] as number;
    const squares = a * a + b * b + c * c;
    const rest = Math.sqrt(Math.max(0, 1 - squares));
    const scale = 1 / Math.sqrt(squares + rest * rest);
    quat[4 * i + largest] = rest * scale;
    quat[4 * i + ((largest + 1) & 3)] = a * scale;
    quat[4 * i + ((largest + 2) & 3)] = b * scale;
    quat[4 * i + ((largest + 3) & 3)] = c * scale;
  }
}

/**
 * Takes apart what the server answers where `live.scene` points: the length of a manifest (u32, little
 * endian), that manifest as JSON (of the same kind as the one in the page, and describing this scene),
 * and the splats without gzip for [decodePayload].
 *
 * @throws PageError if the answer is something else.
 */
export function splitLiveScene(answer: Uint8Array): { manifest: unknown; payload: Uint8Array } {
  const view = new DataView(answer.buffer, answer.byteOffset, answer.byteLength);
  const end = answer.length < 4 ? Infinity : 4 + view.getUint32(0, true);
  if (end > answer.length) throw damaged(`the server sent ${answer.length} bytes, which hold no manifest`);
  try {
    const manifest: unknown = JSON.parse(new TextDecoder().decode(answer.subarray(4, end)));
    return { manifest, payload: answer.subarray(end) };
  } catch (cause) {
    throw damaged("the manifest that the server sent is not JSON", cause);
  }
}
