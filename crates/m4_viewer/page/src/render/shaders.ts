/**
 * Splats at an instant: place, opacity and colour, and the ellipse on the image as the renderer of the
 * training draws it. All of a splat comes at full precision from float textures.
 */

import { type Manifest, shTerms } from "../scene";
import { fetchTexel } from "./columns";
import { shadeStatements } from "./shade";
import { LEAST_PRESENCE, NODE_TEXELS } from "./pose";
import { JACOBIAN_MARGIN, NOTHING } from "./slice";
import { MARGINAL_MIN, marginalGlsl } from "./window";

/** Added to the image covariance, pixels squared (3DGS). */
export const LOW_PASS = 0.3;
const NEAR_MIN = 1e-6;
/**
 * Splats that are drawn as one instance. One of four vertices each would do, and is slow: drivers take instances
 * one by one.
 */
export const BATCH = 1024;

const number = (v: number): string => v.toPrecision(10);

/** Functions for bound splats: `m4_kernels::pose` in GLSL. */
const CARRYING = /* glsl */ `
uniform sampler2D bound;
uniform sampler2D nodes;
uniform int freeFrom;     // the first splat that is not bound

vec3 turned(vec4 q, vec3 v) {
  return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v);
}

vec4 product(vec4 a, vec4 b) {
  return vec4(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz));
}

float rise(float x) {
  float s = clamp(0.5 + 0.5 * x, 0.0, 1.0);
  return s * s * (3.0 - 2.0 * s);
}

/// Moves, turns, fades and colours a bound splat; false where it is not there.
bool carry(int row, vec4 lived, float speed, inout vec3 mean, inout vec4 quat, inout float opacity, out vec3 change) {
  ivec4 links = ivec4(${fetchTexel("bound", "2 * row")});
  vec4 span = ${fetchTexel("bound", "2 * row + 1")};
  float dt = time - lived.x;
  vec3 own = mean + dt * vec3(lived.zw, speed);
  vec4 first = ${fetchTexel("nodes", `${NODE_TEXELS} * (links.x & 65535)`)};
  vec4 sum = vec4(0.0);
  float halfFade = 1.0;
  mean = vec3(0.0);
  for (int k = 0; k < 4; k++) {
    int at = ${NODE_TEXELS} * (links[k] & 65535);
    float weight = float(links[k] >> 16) / 255.0;
    vec4 q = ${fetchTexel("nodes", "at")};
    vec4 shift = ${fetchTexel("nodes", "(at + 1)")};
    mean += weight * (turned(q, own) + shift.xyz);
    sum += (dot(first, q) < 0.0 ? -weight : weight) * q;
    halfFade = shift.w;
  }
  quat = normalize(product(sum, quat));
  change = dt * vec3(lived.y, span.zw);
  float presence = rise((time - span.x) / halfFade) * rise((span.y - time) / halfFade);
  if (!(presence >= ${number(LEAST_PRESENCE)})) return false;
  if (presence < 1.0) opacity = 1.0 - pow(1.0 - opacity, presence);
  return true;
}
`;

/** Statements for splats that are not static. */
const dynamicStatements = ({ splats, period_frames }: Manifest): string => {
  const free = /* glsl */ `float dt = time - lived.x;
    float marginal = ${marginalGlsl("dt", "lived.y")};
    if (!(marginal > ${number(MARGINAL_MIN)})) return;
    opacity *= marginal;
    mean += dt * vec3(lived.zw, scaled.w);
    turns = dt * ${number(1 / period_frames)};`;
  if (splats.bound === 0) return free;
  return /* glsl */ `if (index < freeFrom) {
      if (!carry(index - dynamicFrom, lived, scaled.w, mean, quat, opacity, change)) return;
    } else {
      ${free}
    }`;
};

/** Corners of a parallelogram that holds the ellipse down to an opacity of 1 / 255. */
export const splatVertex = (manifest: Manifest): string => /* glsl */ `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;

uniform usampler2D order;
uniform sampler2D place;
uniform sampler2D shape;
uniform sampler2D life;
uniform sampler2D colours;
uniform int dynamicFrom;  // the first dynamic splat
uniform float time;       // frames
uniform vec3 eye;
uniform mat4 view;        // world to camera, OpenCV axes
uniform vec4 lens;        // fx, fy, cx, cy, pixels
uniform vec2 size;        // of the image, pixels
uniform float near;
uniform float lowPass;    // pixels squared
uniform bool mip;

out vec2 vOffset;         // from the centre, standard deviations
out vec4 vColour;

mat3 axesOf(vec3 s, vec4 q) {
  vec3 r = 2.0 * q.xyz;
  float xx = q.x * r.x, yy = q.y * r.y, zz = q.z * r.z;
  float xy = q.x * r.y, xz = q.x * r.z, yz = q.y * r.z;
  float wx = q.w * r.x, wy = q.w * r.y, wz = q.w * r.z;
  return mat3(
    s.x * vec3(1.0 - yy - zz, xy + wz, xz - wy),
    s.y * vec3(xy - wz, 1.0 - xx - zz, yz + wx),
    s.z * vec3(xz + wy, yz - wx, 1.0 - xx - yy)
  );
}

${manifest.splats.bound > 0 ? CARRYING : ""}
void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  vOffset = vec2(0.0);
  vColour = vec4(0.0);

  uint id = ${fetchTexel("order", `gl_InstanceID * ${BATCH} + (gl_VertexID >> 2)`)}.x;
  if (id == ${NOTHING}u) return;
  int index = int(id);
  vec4 placed = ${fetchTexel("place", "index")};
  vec4 scaled = ${fetchTexel("shape", "2 * index")};
  vec3 mean = placed.xyz;
  float opacity = placed.w;
  vec4 quat = ${fetchTexel("shape", "2 * index + 1")};
  float turns = 0.0;
  vec3 change = vec3(0.0);
  if (index >= dynamicFrom) {
    vec4 lived = ${fetchTexel("life", "(index - dynamicFrom)")};
    ${dynamicStatements(manifest)}
  }
  if (opacity < 1.0 / 255.0) return;

  mat3 turn = mat3(view);
  vec3 p = turn * mean + view[3].xyz;
  if (!(p.z > max(near, ${number(NEAR_MIN)}))) return;
  vec2 ray = p.xy / p.z;

  // covariance in the camera
  mat3 m = turn * axesOf(scaled.xyz, quat);

  // the Jacobian, within a margin of the image
  vec2 margin = ${number(JACOBIAN_MARGIN)} * size / (2.0 * lens.xy);
  vec2 k = clamp(ray, -lens.zw / lens.xy - margin, (size - lens.zw) / lens.xy + margin);
  vec2 f = lens.xy / p.z;
  vec3 row0 = f.x * (vec3(m[0].x, m[1].x, m[2].x) - k.x * vec3(m[0].z, m[1].z, m[2].z));
  vec3 row1 = f.y * (vec3(m[0].y, m[1].y, m[2].y) - k.y * vec3(m[0].z, m[1].z, m[2].z));
  float a = dot(row0, row0), b = dot(row0, row1), d = dot(row1, row1);
  float sharp = max(a * d - b * b, 0.0);
  a += lowPass;
  d += lowPass;
  float det = a * d - b * b;
  if (!(det > 0.0)) return;
  if (mip) opacity *= sqrt(sharp / det);
  if (!(opacity >= 1.0 / 255.0)) return;

  vec3 toSplat = normalize(mean - eye);
  ${shadeStatements("colours", shTerms(manifest), manifest.splats.time_degree + 1).join("\n  ")}

  // the root of the covariance takes the unit circle to the ellipse
  float reach = sqrt(2.0 * log(255.0 * opacity));
  float l00 = sqrt(a), l10 = b / l00, l11 = sqrt(det / a);
  vec2 corner = reach * vec2((gl_VertexID & 1) == 0 ? -1.0 : 1.0, (gl_VertexID & 2) == 0 ? -1.0 : 1.0);
  vec2 pixel = lens.xy * ray + lens.zw + vec2(l00 * corner.x, l10 * corner.x + l11 * corner.y);
  vec2 ndc = 2.0 * pixel / size - 1.0;
  gl_Position = vec4(ndc.x, -ndc.y, 0.0, 1.0);
  vOffset = corner;
  vColour = vec4(colour, opacity);
}
`;

export const SPLAT_FRAGMENT = /* glsl */ `#version 300 es
precision highp float;

in vec2 vOffset;
in vec4 vColour;
out vec4 fragColour;

void main() {
  float alpha = min(vColour.a * exp(-0.5 * dot(vOffset, vOffset)), 0.99);
  if (alpha < 1.0 / 255.0) discard;
  fragColour = vec4(vColour.rgb * alpha, alpha);
}
`;

/** A triangle over everything. */
export const PRESENT_VERTEX = /* glsl */ `#version 300 es
out vec2 vPlace;
void main() {
  vPlace = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(vPlace, 0.0, 1.0);
}
`;

/**
 * The image to the screen as it is, less what the safe region takes away and what lies outside of
 * the frame of the source camera: nothing was ever seen there.
 */
export const PRESENT_FRAGMENT = /* glsl */ `#version 300 es
precision highp float;
uniform highp sampler2D image;
uniform vec2 origin;   // of the image, pixels of the framebuffer
uniform vec3 fadeTo;
uniform float fade;
uniform vec4 frame;    // left, bottom, right, top, pixels
uniform float feather; // pixels
uniform vec3 outside;
in vec2 vPlace;
out vec4 fragColour;

void main() {
  vec2 at = gl_FragCoord.xy - origin;
  vec3 colour = texelFetch(image, ivec2(at), 0).rgb;
  float edge = smoothstep(0.2, 1.2, length(vPlace));
  colour = mix(colour, fadeTo, fade * mix(0.75, 1.0, edge));
  vec2 beyond = max(max(frame.xy - at, at - frame.zw), 0.0);
  float gone = feather > 0.0 ? smoothstep(0.0, 1.0, length(beyond) / feather) : 0.0;
  fragColour = vec4(mix(colour, outside, gone), 1.0);
}
`;
