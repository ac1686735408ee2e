// The object among cameras and lamps, in a parallel projection that dragging and the arrow keys turn.

import { askedBytes } from "./asking.js";
import { cleared, COLOURS } from "./building.js";
import { unpacked } from "./packed.js";
import { direction, dot, radians, turnView } from "./vectors.js";

// From little to much, lighter all the way, so that grey shows it, too.
const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
// The object fills this share of the way to the farthest camera where it would be smaller, and of that to the nearest.
const SEEN = 0.3, CLEAR = 0.6;
// How far out directions are marked, in radii of the object as it is drawn.
const SHELL = 1.55, NEAR = 12;

/** The object in the world as `Space` has it; an error says why nobody knows where it is. */
export async function readSurface() {
  const { arrays, centre, radius, said } = await unpacked(await askedBytes("/api/surface"));
  if (said) throw new Error(said);
  return { positions: arrays.positions.data, faces: arrays.faces.data, centre, radius };
}

/** A colour for a share from 0 to 1. */
export function ramp(share) {
  const at = Math.max(0, Math.min(1, share)) * (RAMP.length - 1), k = Math.min(Math.floor(at), RAMP.length - 2);
  return `rgb(${RAMP[k].map((low, c) => Math.round(low + (at - k) * (RAMP[k + 1][c] - low))).join(",")})`;
}

/**
 * A drawing on a canvas. onProbe is called with the dot under the pointer, or null.
 *
 * What it shows: surface {positions (radii about its centre), faces, centre, radius} or null; cameras {centre, axes,
 * reach, chosen}; dots {direction, share}; arrows {direction, name, colour}, which point to the object.
 */
export class Space {
  constructor(canvas, onProbe = () => {}) {
    Object.assign(this, { canvas, turn: { azimuth: 40, elevation: 25 }, shown: null, placed: [] });
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) this.turnBy(-event.movementX / 2, event.movementY / 2);
      else onProbe(this.dotAt(event));
    });
    canvas.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] };
      if (!(event.key in steps)) return;
      event.preventDefault();
      this.turnBy(...steps[event.key]);
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  show(shown) {
    const { surface, cameras } = shown, middle = surface ? surface.centre : looked(cameras);
    const away = cameras.map(({ centre }) => Math.hypot(...centre.map((x, k) => x - middle[k])));
    const far = Math.max(1e-9, ...away), least = surface?.radius ?? 0;
    const radius = Math.max(least, cameras.length ? Math.min(SEEN * far, CLEAR * Math.min(...away)) : 0) || SEEN * far;
    this.shown = { dots: [], arrows: [], ...shown, middle, far: Math.max(far, 1.5 * SHELL * radius), radius };
    this.draw();
  }

  /** How many times as large the object is drawn as it is, in words; nothing where it isn't. */
  get scaleSaid() {
    const enlarged = this.shown?.surface ? this.shown.radius / this.shown.surface.radius : 1;
    return enlarged > 1.05 ? `The object is drawn ${enlarged.toPrecision(2)} times as large.` : "";
  }

  turnBy(azimuth, elevation) {
    turnView(this.turn, azimuth, elevation);
    this.draw();
  }

  dotAt(event) {
    const { left, top, width } = this.canvas.getBoundingClientRect(), ratio = this.canvas.width / Math.max(width, 1);
    const x = (event.clientX - left) * ratio, y = (event.clientY - top) * ratio;
    const [nearest] = this.placed.map(({ dot: each, at, depth }) => ({ each, depth, off: Math.hypot(at[0] - x, at[1] - y) }))
      .filter(({ off }) => off < NEAR * ratio).sort((a, b) => b.depth - a.depth);
    return nearest?.each ?? null;
  }

  draw() {
    if (!this.shown || !this.canvas.clientWidth) return;
    const { context, width, height, ink, muted, stage, ratio } = cleared(this.canvas);
    const { surface, cameras, dots, arrows, middle, far, radius } = this.shown, a = radians(this.turn.azimuth);
    const towards = direction(this.turn.azimuth, this.turn.elevation), up = direction(this.turn.azimuth, this.turn.elevation + 90);
    const right = [-Math.sin(a), Math.cos(a), 0], scale = (0.4 * Math.min(width, height)) / far;
    const at = (offset) => [width / 2 + scale * dot(offset, right), height / 2 - scale * dot(offset, up)];
    const off = (point) => point.map((x, k) => x - middle[k]);
    const line = (...points) => {
      context.beginPath();
      points.forEach((point) => context.lineTo(...at(point)));
      context.stroke();
    };
    context.font = `${12 * ratio}px system-ui`;
    const parts = surface ? faces(surface, radius, towards, at, context) : [];
    [["X", [1, 0, 0]], ["Y", [0, 1, 0]], ["Z", [0, 0, 1]]].forEach(([name, axis], c) => {
      const [start, tip] = [surface ? radius : 0, surface ? 1.35 * radius : 0.35 * far].map((length) => axis.map((x) => length * x));
      parts.push({ depth: dot(tip, towards), draw: () => {
        Object.assign(context, { strokeStyle: COLOURS[c], fillStyle: COLOURS[c], lineWidth: 1.5 * ratio });
        line(start, tip);
        context.fillText(name, ...at(tip));
      } });
    });
    for (const { centre, axes, reach, chosen } of cameras) {
      const place = off(centre), depth = 0.16 * far;
      // Long lenses see slender pyramids: they are drawn wider, all alike.
      const flat = reach.map((side) => (0.4 * side) / Math.max(...reach));
      const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => place.map((c, i) => c + depth * (axes[2][i] + x * flat[0] * axes[0][i] + y * flat[1] * axes[1][i])));
      parts.push({ depth: dot(place, towards), draw: () => {
        Object.assign(context, { strokeStyle: chosen ? ink : muted, lineWidth: (chosen ? 2.5 : 1) * ratio });
        line(...corners, corners[0]);
        corners.forEach((corner) => line(place, corner));
      } });
    }
    this.placed = dots.map((each) => {
      const place = each.direction.map((x) => SHELL * radius * x);
      return { dot: each, at: at(place), depth: dot(place, towards) };
    });
    for (const { dot: { share }, at: [x, y], depth } of this.placed) {
      parts.push({ depth, draw: () => {
        context.fillStyle = ramp(share);
        context.beginPath();
        context.arc(x, y, (3.5 + 3.5 * share) * ratio, 0, 2 * Math.PI);
        context.fill();
      } });
    }
    for (const { direction: from, colour } of arrows) {
      const [head, neck, tail] = [1.12, 1.3, 2].map((length) => from.map((x) => length * radius * x));
      parts.push({ depth: dot(tail, towards), draw: () => arrow(context, at(tail), at(neck), at(head), colour ?? ink, ratio) });
    }
    parts.sort((one, other) => one.depth - other.depth).forEach((part) => part.draw());
    // Words are over all that is drawn, on a ground of their own.
    for (const { direction: from, name, colour } of arrows) {
      const [[x, y], [tip]] = [2, 1.12].map((length) => at(from.map((part) => length * radius * part)));
      Object.assign(context, { textAlign: x < tip ? "right" : "left", strokeStyle: stage, fillStyle: colour ?? ink, lineWidth: 4 * ratio });
      context.strokeText(name, x, y - 5 * ratio);
      context.fillText(name, x, y - 5 * ratio);
    }
    context.textAlign = "left";
  }
}

function arrow(context, tail, neck, head, colour, ratio) {
  Object.assign(context, { strokeStyle: colour, fillStyle: colour, lineWidth: 2.5 * ratio });
  const across = [(neck[1] - head[1]) / 2.5, (head[0] - neck[0]) / 2.5];
  context.beginPath();
  context.moveTo(...tail);
  context.lineTo(...neck);
  context.stroke();
  context.beginPath();
  context.moveTo(...head);
  context.lineTo(neck[0] + across[0], neck[1] + across[1]);
  context.lineTo(neck[0] - across[0], neck[1] - across[1]);
  context.fill();
}

/** The faces that look at us, shaded by how much they do. */
function faces({ positions, faces: corners }, radius, towards, at, context) {
  const found = [], point = (k) => [positions[3 * k] * radius, positions[3 * k + 1] * radius, positions[3 * k + 2] * radius];
  for (let k = 0; k < corners.length; k += 3) {
    const [p, q, r] = [point(corners[k]), point(corners[k + 1]), point(corners[k + 2])];
    const [u, v] = [q, r].map((other) => other.map((x, i) => x - p[i]));
    const normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const facing = dot(normal, towards) / (Math.hypot(...normal) || 1);
    if (facing <= 0) continue;
    const grey = Math.round(70 + 130 * facing);
    found.push({ depth: (dot(p, towards) + dot(q, towards) + dot(r, towards)) / 3, draw: () => {
      context.fillStyle = context.strokeStyle = `rgb(${grey},${grey},${grey})`;
      context.lineWidth = 0.7;
      context.beginPath();
      [p, q, r].forEach((each) => context.lineTo(...at(each)));
      context.closePath();
      context.fill();
      context.stroke();
    } });
  }
  return found;
}

/** The point that is nearest to all cameras' lines of sight, least squares; the mean of them where these are parallel. */
function looked(cameras) {
  const sums = [0, 1, 2].map(() => [0, 0, 0, 0]), mean = [0, 0, 0];
  for (const { centre, axes } of cameras) {
    for (let i = 0; i < 3; i++) {
      mean[i] += centre[i] / cameras.length;
      for (let j = 0; j < 3; j++) {
        const across = (i === j ? 1 : 0) - axes[2][i] * axes[2][j];
        sums[i][j] += across;
        sums[i][3] += across * centre[j];
      }
    }
  }
  // Gauss's elimination of three equations.
  for (let i = 0; i < 3; i++) {
    const best = [0, 1, 2].slice(i).reduce((a, b) => (Math.abs(sums[b][i]) > Math.abs(sums[a][i]) ? b : a), i);
    [sums[i], sums[best]] = [sums[best], sums[i]];
    if (Math.abs(sums[i][i]) < 1e-4 * cameras.length) return mean;
    for (let j = 0; j < 3; j++) {
      if (j === i) continue;
      const factor = sums[j][i] / sums[i][i];
      sums[j] = sums[j].map((value, k) => value - factor * sums[i][k]);
    }
  }
  return sums.map((equation, i) => equation[3] / equation[i]);
}
