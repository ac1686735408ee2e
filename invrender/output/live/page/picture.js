// Draws a subject under lights with WebGL2: to a canvas, and as numbers.

import { boxTree } from "./boxtree.js";
import { singles } from "./packed.js";
import { MOST_LAMPS, MOST_TERMS, REFLECTED, ROW, SHOWN, SURFACE, WHOLE } from "./shaders.js";
import { cross, direction, radians, scaled, turnedAboutZ, viewed } from "./vectors.js";

const SAMPLES = 4;

export class Picture {
  /** canvas : to draw to. subject : unpacked. Throws where the browser lacks WebGL2 or float pictures. */
  constructor(canvas, subject) {
    const gl = canvas.getContext("webgl2", { alpha: true, antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser has no WebGL2, which live pictures need.");
    if (!gl.getExtension("EXT_color_buffer_float")) throw new Error("This graphics card can't draw to float pictures.");
    Object.assign(this, { canvas, gl, subject, lights: [], fence: null });
    this.surface = program(gl, SURFACE, REFLECTED);
    this.shown = program(gl, WHOLE, SHOWN);
    this.empty = gl.createVertexArray();
    this.load(subject);
  }

  load({ arrays, shadows }) {
    const gl = this.gl, faces = arrays.faces.data, positions = arrays.positions.data;
    this.vertices = arrays.positions.shape[0];
    // Corners of faces one after the other, so that each face has its own normal, too.
    this.corners = faces;
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    const attribute = (name, array) => {
      const size = array.shape[1], values = array.type === "f16" ? singles(array.data) : array.data;
      this.attribute(name, atCorners(values, size, faces), size);
    };
    attribute("aPosition", arrays.positions);
    attribute("aNormal", arrays.normals);
    this.attribute("aFacet", facetNormals(positions, faces), 3);
    if (arrays.uv) attribute("aUv", arrays.uv);
    for (const [name, at] of [["aKd", arrays.kdAtVertices], ["aKs", arrays.ksAtVertices]]) {
      if (at) attribute(name, at);
      else gl.vertexAttrib4f(gl.getAttribLocation(this.surface, name), 1, 1, 1, 1);
    }
    this.received = this.attribute("aIrradiance", new Float32Array(3 * faces.length), 3, gl.DYNAMIC_DRAW);
    this.kdMap = codes(gl, arrays.kdCodes);
    this.ksMap = codes(gl, arrays.ksCodes);
    this.volume = halves(gl, gl.TEXTURE_3D, gl.R16F, gl.RED, arrays.volume.data, arrays.volume.shape);
    this.transmitted = halves(gl, gl.TEXTURE_2D, gl.R16F, gl.RED, arrays.transmitted.data, [1, ...arrays.transmitted.shape]);
    const tree = shadows ? boxTree(positions, faces) : boxTree(new Float32Array(9), [0, 1, 2]);
    this.nodes = rowsOf(gl, tree.nodes);
    this.triangles = rowsOf(gl, tree.triangles);
    this.nodeCount = tree.count;
  }

  attribute(name, data, size, usage = this.gl.STATIC_DRAW) {
    const gl = this.gl, place = gl.getAttribLocation(this.surface, name), buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, usage);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0);
    return buffer;
  }

  /** Takes an unpacked light under a number, the next one if none is given. */
  add(light, number = this.lights.length) {
    const gl = this.gl, { maps, functions, lamps, irradiances, series } = light.arrays;
    if (light.orders.length > MOST_TERMS) throw new Error(`A light has ${light.orders.length} maps; ${MOST_TERMS} are drawn.`);
    const [terms, rows, columns] = maps.shape, texels = new Uint16Array(4 * terms * rows * columns);
    for (let k = 0; k < texels.length / 4; k++) texels.set(maps.data.subarray(3 * k, 3 * k + 3), 4 * k);
    this.lights[number] = {
      ...light,
      maps: halves(gl, gl.TEXTURE_2D_ARRAY, gl.RGBA16F, gl.RGBA, texels, [terms, rows, columns], gl.REPEAT),
      functions: halves(gl, gl.TEXTURE_2D, gl.R16F, gl.RED, functions.data, functions.shape),
      lamps: rowsOfNumbers(lamps),
      irradiances: rowsOfNumbers(irradiances),
      series: { values: singles(series.data), length: series.shape[1] },
    };
  }

  /** Irradiance of vertices by a light, its lamps aside, turned by so many degrees, to the graphics card. */
  receive(light, turn) {
    if (this.receives === light && this.receivedAt === turn) return;
    const { values, length } = light.series, weights = new Float32Array(length), result = new Float32Array(3 * this.vertices);
    weights[0] = 1;
    for (let m = 1; 2 * m < length + 1; m++) {
      weights[2 * m - 1] = Math.cos(m * radians(turn));
      weights[2 * m] = Math.sin(m * radians(turn));
    }
    for (let v = 0; v < this.vertices; v++) {
      for (let c = 0; c < 3; c++) {
        let sum = 0;
        for (let m = 0; m < length; m++) sum += weights[m] * values[3 * (v * length + m) + c];
        result[3 * v + c] = Math.max(sum, 0);
      }
    }
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.received);
    this.gl.bufferSubData(this.gl.ARRAY_BUFFER, 0, atCorners(result, 3, this.corners));
    this.receives = light;
    this.receivedAt = turn;
  }

  /** Draws radiance over the light's unit to a float picture of a size; returns the framebuffer that holds it. */
  expose(state, width, height) {
    const gl = this.gl, light = this.lights[state.light], use = (name) => gl.getUniformLocation(this.surface, name);
    const camera = viewed(this.subject.camera, state, width, height);
    const target = this.target(width, height);
    this.receive(light, state.turn);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.drawn);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.disable(gl.BLEND);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.surface);
    gl.bindVertexArray(this.array);
    gl.uniformMatrix4fv(use("uMatrix"), false, camera.matrix);
    gl.uniform1i(use("uOrthographic"), this.subject.camera.orthographic ? 1 : 0);
    gl.uniform1i(use("uShadows"), this.subject.shadows ? 1 : 0);
    gl.uniform3fv(use("uEye"), camera.place);
    gl.uniform3fv(use("uOutward"), camera.outward);
    gl.uniform3fv(use("uKd"), this.subject.kd);
    gl.uniform3fv(use("uKs"), this.subject.ks);
    gl.uniform1f(use("uWidth"), this.subject.width);
    gl.uniform1f(use("uLeastCos"), this.subject.leastCos);
    gl.uniform1f(use("uRoom"), state.room);
    gl.uniform1f(use("uLeastKnown"), state.filled ? 0 : this.subject.leastKnown);
    const c = Math.cos(radians(state.turn)), s = Math.sin(radians(state.turn));
    gl.uniformMatrix3fv(use("uToLight"), false, [c, -s, 0, s, c, 0, 0, 0, 1]);
    gl.uniform1i(use("uTerms"), light.orders.length);
    gl.uniform1iv(use("uOrders"), light.orders);
    const lamps = lampsOf(light, state);
    gl.uniform1i(use("uLamps"), lamps.length);
    if (lamps.length) {
      gl.uniform4fv(use("uLamp"), lamps.flatMap((lamp) => lamp.place));
      gl.uniform3fv(use("uStrength"), lamps.flatMap((lamp) => lamp.strength));
    }
    gl.uniform1i(use("uNodeCount"), this.nodeCount);
    const textures = [
      ["uKdMap", gl.TEXTURE_2D, this.kdMap], ["uKsMap", gl.TEXTURE_2D, this.ksMap],
      ["uFunctions", gl.TEXTURE_2D, light.functions], ["uTransmitted", gl.TEXTURE_2D, this.transmitted],
      ["uNodes", gl.TEXTURE_2D, this.nodes], ["uTriangles", gl.TEXTURE_2D, this.triangles],
      ["uMaps", gl.TEXTURE_2D_ARRAY, light.maps], ["uVolume", gl.TEXTURE_3D, this.volume],
    ];
    textures.forEach(([name, kind, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(kind, texture);
      gl.uniform1i(use(name), unit);
    });
    gl.drawArrays(gl.TRIANGLES, 0, this.corners.length);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, target.drawn);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, target.resolved);
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    return target;
  }

  /** Shows a state on the canvas. */
  draw(state) {
    const gl = this.gl, { width, height } = this.canvas;
    const target = this.expose(state, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    gl.useProgram(this.shown);
    gl.bindVertexArray(this.empty);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, target.texture);
    gl.uniform1i(gl.getUniformLocation(this.shown, "uPicture"), 0);
    gl.uniform1f(gl.getUniformLocation(this.shown, "uExposure"), 2 ** state.exposure);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
  }

  /** Whether the graphics card still works on what was drawn last. */
  busy() {
    const gl = this.gl;
    if (this.fence && gl.getSyncParameter(this.fence, gl.SYNC_STATUS) === gl.SIGNALED) {
      gl.deleteSync(this.fence);
      this.fence = null;
    }
    return this.fence !== null;
  }

  /** Radiance and coverage, (height, width, 4) from the top left on, in the light's own scale. */
  radiance(state, width, height) {
    const gl = this.gl, target = this.expose(state, width, height), pixels = new Float32Array(4 * width * height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.resolved);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, pixels);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    const result = new Float32Array(pixels.length), unit = this.lights[state.light].unit;
    for (let row = 0; row < height; row++) {
      result.set(pixels.subarray(4 * width * (height - 1 - row), 4 * width * (height - row)), 4 * width * row);
    }
    return result.map((value, k) => (k % 4 < 3 ? value * unit : value));
  }

  /** Radiance and coverage (4) of one pixel of a picture of a size. */
  pixel(state, width, height, column, row) {
    const gl = this.gl, target = this.expose(state, width, height), value = new Float32Array(4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.resolved);
    gl.readPixels(column, height - 1 - row, 1, 1, gl.RGBA, gl.FLOAT, value);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    const unit = this.lights[state.light].unit;
    return [value[0] * unit, value[1] * unit, value[2] * unit, value[3]];
  }

  target(width, height) {
    const gl = this.gl;
    if (this.targetNow?.width === width && this.targetNow.height === height) return this.targetNow;
    if (this.targetNow) {
      const { drawn, resolved, texture, buffers } = this.targetNow;
      [drawn, resolved].forEach((each) => gl.deleteFramebuffer(each));
      buffers.forEach((each) => gl.deleteRenderbuffer(each));
      gl.deleteTexture(texture);
    }
    const drawn = gl.createFramebuffer(), resolved = gl.createFramebuffer(), texture = gl.createTexture();
    gl.bindFramebuffer(gl.FRAMEBUFFER, drawn);
    const formats = [[gl.RGBA16F, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]];
    const buffers = formats.map(([format, attachment]) => {
      const buffer = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, SAMPLES, format, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment, gl.RENDERBUFFER, buffer);
      return buffer;
    });
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, resolved);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    this.targetNow = { width, height, drawn, resolved, texture, buffers };
    return this.targetNow;
  }
}

/** Lamps of a light as it is turned and dimmed, and those that the state adds: {place (4), strength (3)}. */
function lampsOf(light, state) {
  const own = light.lamps.map(([x, y, z, near], k) => ({
    place: [...turnedAboutZ([x, y, z], state.turn), near],
    strength: light.irradiances[k].map((value) => value * state.room),
  }));
  const added = state.lamps.map(({ azimuth, elevation, strength }) => ({
    place: [...direction(azimuth, elevation), 0],
    strength: [1, 1, 1].map(() => strength * Math.PI),
  }));
  return [...own, ...added].filter(({ strength }) => Math.max(...strength) > 0).slice(0, MOST_LAMPS);
}

/** Values of vertices, so many each, at all corners of faces. */
function atCorners(values, size, faces) {
  const result = new Float32Array(size * faces.length);
  for (let k = 0; k < faces.length; k++) {
    for (let c = 0; c < size; c++) result[size * k + c] = values[size * faces[k] + c];
  }
  return result;
}

/** Outward normals of faces at all their corners. */
function facetNormals(positions, faces) {
  const result = new Float32Array(3 * faces.length), corner = (k) => positions.subarray(3 * faces[k], 3 * faces[k] + 3);
  for (let k = 0; k < faces.length; k += 3) {
    const [a, b, c] = [corner(k), corner(k + 1), corner(k + 2)];
    const across = cross([b[0] - a[0], b[1] - a[1], b[2] - a[2]], [c[0] - a[0], c[1] - a[1], c[2] - a[2]]);
    const normal = scaled(across, 1 / Math.max(Math.hypot(...across), 1e-30));
    for (let i = 0; i < 3; i++) result.set(normal, 3 * (k + i));
  }
  return result;
}

function rowsOfNumbers({ data, shape: [rows, columns] }) {
  return Array.from({ length: rows }, (_, k) => Array.from(data.subarray(columns * k, columns * (k + 1))));
}

function program(gl, vertex, fragment) {
  const result = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(result, shader);
  }
  gl.linkProgram(result);
  if (!gl.getProgramParameter(result, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(result));
  return result;
}

function filtered(gl, kind, around, min = gl.LINEAR) {
  gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, min);
  gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
  gl.texParameteri(kind, gl.TEXTURE_WRAP_S, around);
  gl.texParameteri(kind, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  gl.texParameteri(kind, gl.TEXTURE_WRAP_R, gl.CLAMP_TO_EDGE);
}

/** A texture of half floats; shape : (rows, columns) or (layers, rows, columns). */
function halves(gl, kind, inside, format, data, shape, around = gl.CLAMP_TO_EDGE) {
  const texture = gl.createTexture(), sizes = [...shape].reverse();
  gl.bindTexture(kind, texture);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  if (sizes.length === 2) gl.texImage2D(kind, 0, inside, ...sizes, 0, format, gl.HALF_FLOAT, data);
  else gl.texImage3D(kind, 0, inside, ...sizes, 0, format, gl.HALF_FLOAT, data);
  filtered(gl, kind, around);
  return texture;
}

/** A texture of sRGB codes (h, w, 4), with smaller copies of itself. */
function codes(gl, { data, shape: [height, width] }) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, data);
  gl.generateMipmap(gl.TEXTURE_2D);
  filtered(gl, gl.TEXTURE_2D, gl.REPEAT, gl.LINEAR_MIPMAP_LINEAR);
  const slanted = gl.getExtension("EXT_texture_filter_anisotropic");
  if (slanted) gl.texParameterf(gl.TEXTURE_2D, slanted.TEXTURE_MAX_ANISOTROPY_EXT, 8);
  return texture;
}

/** Numbers, four to a texel, in rows of `ROW`. */
function rowsOf(gl, numbers) {
  const rows = Math.max(Math.ceil(numbers.length / 4 / ROW), 1), padded = new Float32Array(4 * ROW * rows);
  padded.set(numbers);
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, ROW, rows, 0, gl.RGBA, gl.FLOAT, padded);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  return texture;
}
