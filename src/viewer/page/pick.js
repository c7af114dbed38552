// What is under a point of the picture, with the weights that blending gives each Gaussian there.

/**
 * The object with the largest share of the point (x, y) of the camera's image, and where it is: the mean centre of its
 * Gaussians, by weight. Nothing where no Gaussian has a part.
 */
function pick(scene, order, objects, camera, x, y) {
  const { geometry } = scene;
  const [r, { fx, fy, cx, cy, width, height }] = [camera.rotation, camera];
  const [lowX, highX] = [-(0.15 * width + cx) / fx, (1.15 * width - cx) / fx];
  const [lowY, highY] = [-(0.15 * height + cy) / fy, (1.15 * height - cy) / fy];
  const [c0, c1, c2] = camera.center;
  const found = new Map();
  const [m1, m2] = [[0, 0, 0], [0, 0, 0]];
  let transmittance = 1;
  for (let k = order.length - 1; k >= 0 && transmittance > 1e-3; k--) {
    const at = FLOATS * order.drawn[k];
    const offset = objects[geometry[at + OBJECT]].offset;
    const [dx, dy, dz] = [geometry[at] + offset[0] - c0, geometry[at + 1] + offset[1] - c1, geometry[at + 2] + offset[2] - c2];
    const depth = r[6] * dx + r[7] * dy + r[8] * dz;
    const [u, v] = [(r[0] * dx + r[1] * dy + r[2] * dz) / depth, (r[3] * dx + r[4] * dy + r[5] * dz) / depth];
    const [lu, lv] = [Math.min(Math.max(u, lowX), highX), Math.min(Math.max(v, lowY), highY)];
    for (let j = 0; j < 3; j++) {
      const a = at + 4 + 4 * j;
      const along = r[6] * geometry[a] + r[7] * geometry[a + 1] + r[8] * geometry[a + 2];
      m1[j] = (fx / depth) * (r[0] * geometry[a] + r[1] * geometry[a + 1] + r[2] * geometry[a + 2] - lu * along);
      m2[j] = (fy / depth) * (r[3] * geometry[a] + r[4] * geometry[a + 1] + r[5] * geometry[a + 2] - lv * along);
    }
    const [px, py] = [x - (fx * u + cx), y - (fy * v + cy)];
    const [xx, xy, yy] = [dot(m1, m1) + 0.3, dot(m1, m2), dot(m2, m2) + 0.3];
    const across = cross(m1, m2);
    const determinant = dot(across, across) + 0.3 * (xx + yy) - 0.09;
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
