// Small vectors, and the camera that `lightfactor render --view` has.

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
export const scaled = (a, s) => a.map((x) => x * s);
export const radians = (degrees) => (degrees * Math.PI) / 180;

/** Unit vector at azimuth (from +X towards +Y) and elevation, degrees. */
export function direction(azimuth, elevation) {
  const a = radians(azimuth), e = radians(elevation);
  return [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
}

/** Degrees brought to -180 to 180. */
export function around(degrees) {
  return ((((degrees + 180) % 360) + 360) % 360) - 180;
}

/** Turns a view, {azimuth, elevation}, by so many degrees; it stays below the poles, where up is anything. */
export function turnView(view, azimuth, elevation) {
  view.azimuth = around(view.azimuth + azimuth);
  view.elevation = Math.max(-89, Math.min(89, view.elevation + elevation));
}

/** A vector turned about +Z by so many degrees. */
export function turnedAboutZ([x, y, z], degrees) {
  const c = Math.cos(radians(degrees)), s = Math.sin(radians(degrees));
  return [c * x - s * y, s * x + c * y, z];
}

/**
 * The camera of a view, lengths in radii about the object's centre: its place, its axes, and the column-major matrix
 * from there to clip space. view : {azimuth, elevation, zoom}; camera : as the header has it.
 */
export function viewed(camera, view, width, height) {
  const outward = direction(view.azimuth, view.elevation);
  const a = radians(view.azimuth), e = radians(view.elevation);
  const up = [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)];
  const right = cross(up, outward);
  const place = scaled(outward, camera.radii);
  // A picture of other proportions keeps the field of view along its shorter side.
  const fit = Math.min(width / camera.reach[0], height / camera.reach[1]);
  const reach = [width / fit / view.zoom, height / fit / view.zoom];
  const near = camera.orthographic ? camera.radii - 2 : Math.max(camera.radii - 1.5, 0.05), far = camera.radii + 2;
  const away = dot(outward, place);
  const rows = [
    [...scaled(right, 1 / reach[0]), 0],
    [...scaled(up, 1 / reach[1]), 0],
  ];
  if (camera.orthographic) {
    rows.push([...scaled(outward, -2 / (far - near)), (2 * away - far - near) / (far - near)], [0, 0, 0, 1]);
  } else {
    const f = (far + near) / (far - near), g = (2 * far * near) / (far - near);
    rows.push([...scaled(outward, -f), f * away - g], [...scaled(outward, -1), away]);
  }
  const matrix = new Float32Array(16);
  rows.forEach((row, i) => row.forEach((value, j) => { matrix[4 * j + i] = value; }));
  return { matrix, place, outward, right, up, reach };
}
