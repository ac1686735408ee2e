// The shaders of live pictures; `invrender.output.live.drawn` computes the same in Python, and tests compare the two.

export const MOST_TERMS = 64, MOST_LAMPS = 8, ROW = 1536;

export const SURFACE = `#version 300 es
in vec3 aPosition, aNormal, aFacet, aIrradiance;
in vec2 aUv;
in vec4 aKd, aKs;
uniform mat4 uMatrix;
// Within what a triangle covers of a pixel: the pixel's middle may lie below another triangle.
centroid out vec3 position, normal, irradiance;
flat out vec3 facet;
centroid out vec2 uv;
centroid out vec4 kdHere, ksHere;
void main() {
  position = aPosition;
  normal = aNormal;
  facet = aFacet;
  irradiance = aIrradiance;
  uv = aUv;
  kdHere = aKd;
  ksHere = aKs;
  gl_Position = uMatrix * vec4(aPosition, 1.0);
}`;

export const REFLECTED = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;
precision highp sampler3D;
// Smaller copies of a texture hold the mean over more than a pixel.
const float PI = 3.14159265358979, SHARPER = -1.0;
centroid in vec3 position, normal, irradiance;
flat in vec3 facet;
centroid in vec2 uv;
centroid in vec4 kdHere, ksHere;
uniform bool uOrthographic, uShadows;
uniform vec3 uEye, uOutward, uKd, uKs;
uniform sampler2D uKdMap, uKsMap, uFunctions, uTransmitted, uNodes, uTriangles;
uniform sampler2DArray uMaps;
uniform sampler3D uVolume;
uniform int uTerms, uLamps, uNodeCount;
uniform int uOrders[${MOST_TERMS}];
uniform vec4 uLamp[${MOST_LAMPS}];
uniform vec3 uStrength[${MOST_LAMPS}];
uniform float uWidth, uLeastCos, uRoom, uLeastKnown;
uniform mat3 uToLight;
out vec4 radiance;

vec4 texel(sampler2D of, int index) {
  return texelFetch(of, ivec2(index % ${ROW}, index / ${ROW}), 0);
}

// Whether a triangle is in the way of a ray, less far than reach [Moller and Trumbore 1997].
bool met(int triangle, vec3 start, vec3 towards, float reach) {
  vec3 a = texel(uTriangles, 3 * triangle).xyz;
  vec3 one = texel(uTriangles, 3 * triangle + 1).xyz - a, other = texel(uTriangles, 3 * triangle + 2).xyz - a;
  vec3 across = cross(towards, other);
  float area = dot(one, across);
  if (area == 0.0) return false;
  vec3 offset = (start - a) / area;
  float u = dot(offset, across);
  vec3 turned = cross(offset, one);
  float v = dot(towards, turned), far = dot(other, turned);
  return u >= 0.0 && v >= 0.0 && u + v <= 1.0 && far > 0.0 && far < reach;
}

// Whether the surface sees a direction, as far as reach.
bool sees(vec3 towards, float reach) {
  if (dot(facet, towards) <= 0.0) return false;
  vec3 start = position + 2e-4 * facet, inverse = 1.0 / towards;
  for (int node = 0; node < uNodeCount;) {
    vec4 low = texel(uNodes, 3 * node), high = texel(uNodes, 3 * node + 1);
    vec3 a = (low.xyz - start) * inverse, b = (high.xyz - start) * inverse;
    vec3 enter = min(a, b), leave = max(a, b);
    float first = max(max(enter.x, enter.y), max(enter.z, 0.0));
    float last = min(min(leave.x, leave.y), min(leave.z, reach));
    if (first > last) { node = int(low.w); continue; }
    int triangle = int(high.w);
    if (triangle >= 0) {
      int size = int(texel(uNodes, 3 * node + 2).x);
      for (int k = 0; k < size; k++) if (met(triangle + k, start, towards, reach)) return false;
    }
    node += 1;
  }
  return true;
}

float transmitted(float cosine) {
  float count = float(textureSize(uTransmitted, 0).x);
  return texture(uTransmitted, vec2((clamp(cosine, 0.0, 1.0) * (count - 1.0) + 0.5) / count, 0.5)).r;
}

// Radiance by the map, per unit of Ks [R02, section 5.4]: see lobe_maps.py.
vec3 mapped(vec3 n, vec3 v) {
  float cosine = dot(n, v);
  vec3 mirrored = 2.0 * cosine * n - v;
  cosine = clamp(cosine, uLeastCos, 1.0);
  float level = max(length(mirrored.xy), 1e-6);
  float east = (mirrored.x * v.y - mirrored.y * v.x) / level;
  float south = (dot(mirrored, v) * mirrored.z - v.z) / level;
  float phi = atan(east, south);
  vec2 counts = vec2(textureSize(uFunctions, 0));
  float entry = (acos(cosine) / acos(uLeastCos) * (counts.y - 1.0) + 0.5) / counts.y;
  float rows = float(textureSize(uMaps, 0).y) - 2.0;
  float row = acos(clamp(mirrored.z, -1.0, 1.0)) / PI * rows + 1.0;
  vec2 place = vec2(atan(mirrored.y, mirrored.x) / (2.0 * PI), row / (rows + 2.0));
  vec3 total = vec3(0.0);
  for (int k = 0; k < uTerms; k++) {
    float q = float(uOrders[k]);
    float wave = q < 0.0 ? sin(-q * phi) : cos(q * phi);
    float weight = wave * texture(uFunctions, vec2((float(k) + 0.5) / counts.x, entry)).r / cosine;
    total += weight * textureLod(uMaps, vec3(place, float(k)), 0.0).rgb;
  }
  return max(total, 0.0);
}

// What the lobe reflects of unit irradiance across a beam: see lobe_volume.py.
float lobe(vec3 n, vec3 towards, vec3 v) {
  vec3 h = normalize(towards + v);
  float cosH = clamp(dot(h, n), 0.0, 1.0), cosD = clamp(dot(h, v), 0.0, 1.0);
  float sines = sqrt((1.0 - cosH * cosH) * (1.0 - cosD * cosD));
  float phi = acos(clamp((cosH * cosD - dot(n, towards)) / max(sines, 1e-6), -1.0, 1.0));
  // Not by acos, which loses half the digits where the lobe peaks.
  float thetaH = atan(length(cross(h, n)), dot(h, n));
  vec3 counts = vec3(textureSize(uVolume, 0));
  vec3 place = vec3(asinh(thetaH / uWidth) / asinh(PI / 2.0 / uWidth), 1.0 - sqrt(max(1.0 - acos(cosD) / (PI / 2.0), 0.0)), phi / PI);
  return texture(uVolume, (place * (counts - 1.0) + 0.5) / counts).r / max(dot(n, v), uLeastCos);
}

void main() {
  vec4 kdShown = kdHere * texture(uKdMap, vec2(uv.x, 1.0 - uv.y), SHARPER);
  vec4 ksShown = ksHere * texture(uKsMap, vec2(uv.x, 1.0 - uv.y), SHARPER);
  vec3 view = uOrthographic ? uOutward : normalize(uEye - position);
  if (kdShown.a < uLeastKnown) discard;
  vec3 n = normalize(normal);
  float cosine = dot(n, view);
  if (cosine < uLeastCos) {
    vec3 across = n - cosine * view;
    n = uLeastCos * view + sqrt(1.0 - uLeastCos * uLeastCos) * across / max(length(across), 1e-12);
    cosine = uLeastCos;
  }
  vec3 diffuse = uRoom * irradiance, specular = vec3(0.0);
  if (uTerms > 0) {
    vec3 mirrored = 2.0 * cosine * n - view;
    if (!uShadows || sees(mirrored, 1e9)) specular = uRoom * mapped(uToLight * n, uToLight * view);
  }
  for (int k = 0; k < uLamps; k++) {
    vec3 towards = uLamp[k].xyz - uLamp[k].w * position;
    float size = length(towards);
    towards /= size;
    float lit = dot(n, towards);
    if (lit <= 0.0) continue;
    float reach = uLamp[k].w > 0.0 ? size / uLamp[k].w : 1e9;
    if (uShadows && !sees(towards, reach)) continue;
    vec3 beam = uStrength[k] / (size * size);
    diffuse += beam * lit * transmitted(lit);
    specular += beam * lobe(n, towards, view);
  }
  radiance = vec4(uKd * kdShown.rgb * diffuse * transmitted(cosine) + uKs * ksShown.rgb * specular, 1.0);
}`;

export const WHOLE = `#version 300 es
out vec2 place;
void main() {
  place = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0;
  gl_Position = vec4(2.0 * place - 1.0, 0.0, 1.0);
}`;

export const SHOWN = `#version 300 es
precision highp float;
in vec2 place;
uniform sampler2D uPicture;
uniform float uExposure;
out vec4 shown;
void main() {
  vec4 here = texture(uPicture, place);
  vec3 linear = clamp(uExposure * here.rgb / max(here.a, 1e-4), 0.0, 1.0);
  vec3 low = 12.92 * linear, high = 1.055 * pow(linear, vec3(1.0 / 2.4)) - 0.055;
  shown = vec4(mix(high, low, lessThanEqual(linear, vec3(0.0031308))) * here.a, here.a);
}`;
