// What is under a point of the picture, with the weights that blending gives each Gaussian there.

const LOW_PASS = 0.3; // square pixels, as in splat.vert

/**
 * The object with the largest share of the point (x, y) of the camera's image, and where it is: the mean centre of its
 * Gaussians, by weight. Nothing where no Gaussian has a part.
 */
function pick(scene, order, objects, camera, x, y) {
  const { geometry } = scene;
  const { fx, fy, cx, cy, width, height } = camera;
  const [r0, r1, r2, r3, r4, r5, r6, r7, r8] = camera.rotation;
  const [lowX, highX] = [-(0.15 * width + cx) / fx, (1.15 * width - cx) / fx];
  const [lowY, highY] = [-(0.15 * height + cy) / fy, (1.15 * height - cy) / fy];
  const [c0, c1, c2] = camera.center;
  const found = new Map();
  let transmittance = 1;
  for (let k = order.length - 1; k >= 0 && transmittance > 1e-3; k--) {
    const at = FLOATS * order.drawn[k];
    const offset = objects[geometry[at + OBJECT]].offset;
    const dx = geometry[at] + offset[0] - c0;
    const dy = geometry[at + 1] + offset[1] - c1;
    const dz = geometry[at + 2] + offset[2] - c2;
    const depth = r6 * dx + r7 * dy + r8 * dz;
    const u = (r0 * dx + r1 * dy + r2 * dz) / depth;
    const v = (r3 * dx + r4 * dy + r5 * dz) / depth;
    const lu = Math.min(Math.max(u, lowX), highX);
    const lv = Math.min(Math.max(v, lowY), highY);
    // Sums over the axes of products of what they are on the screen, and the squared cross product, pair by pair.
    let xx = 0, xy = 0, yy = 0, across = 0, m0 = 0, n0 = 0, m1 = 0, n1 = 0;
    for (let a = at + 4; a < at + 16; a += 4) {
      const [ax, ay, az] = [geometry[a], geometry[a + 1], geometry[a + 2]];
      const along = r6 * ax + r7 * ay + r8 * az;
      const m = (fx / depth) * (r0 * ax + r1 * ay + r2 * az - lu * along);
      const n = (fy / depth) * (r3 * ax + r4 * ay + r5 * az - lv * along);
      across += (m * n0 - n * m0) ** 2 + (m * n1 - n * m1) ** 2;
      [m1, n1, m0, n0] = [m0, n0, m, n];
      xx += m * m;
      xy += m * n;
      yy += n * n;
    }
    const determinant = across + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS;
    yy += LOW_PASS;
    const px = x - (fx * u + cx);
    const py = y - (fy * v + cy);
    const power = 0.5 * ((yy * px - xy * py) ** 2 / (yy * determinant) + (py * py) / yy);
    const alpha = Math.min(scene.alpha_max, geometry[at + OPACITY] * Math.exp(-power));
    if (!(alpha >= 1 / 255)) continue;
    const weight = transmittance * alpha;
    transmittance *= 1 - alpha;
    const object = geometry[at + OBJECT];
    const sum = found.get(object) ?? { object, weight: 0, point: [0, 0, 0] };
    sum.weight += weight;
    sum.point = add(sum.point, times(weight, add([dx, dy, dz], camera.center)));
    found.set(object, sum);
  }
  const best = [...found.values()].reduce((a, b) => (b.weight > (a?.weight ?? 0) ? b : a), null);
  // A veil over nothing is not a thing to hold on to.
  if (!best || 1 - transmittance < 0.1) return null;
  return { object: best.object, share: best.weight, point: times(1 / best.weight, best.point) };
}
