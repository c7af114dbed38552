// The object at a point of the picture, by the weights that blending gives each Gaussian there.

const LOW_PASS = 0.3; // square pixels, as in splat.vert

/**
 * The object with the largest share of the point (x, y) of the camera's image, and where it is: the mean centre of its
 * Gaussians, by weight. Nothing where no Gaussian has a share.
 */
function pick(scene, order, objects, camera, x, y) {
  const { geometry } = scene;
  const { fx, fy, cx, cy, width, height } = camera;
  const [lowX, highX] = [-(0.15 * width + cx) / fx, (1.15 * width - cx) / fx];
  const [lowY, highY] = [-(0.15 * height + cy) / fy, (1.15 * height - cy) / fy];
  // Each object's own coordinates to the camera's: a rotation row by row, then a shift.
  const poses = objects.map(({ pose }) => pose);
  const views = poses.map(({ rotation, shift }) => [
    ...multiply(camera.rotation, rotation), ...apply(camera.rotation, minus(shift, camera.center)),
  ]);
  const found = new Map();
  let transmittance = 1;
  for (let k = order.length - 1; k >= 0 && transmittance > 1e-3; k--) {
    const at = FLOATS * order.drawn[k];
    const view = views[geometry[at + OBJECT]];
    const [mx, my, mz] = [geometry[at], geometry[at + 1], geometry[at + 2]];
    const depth = view[6] * mx + view[7] * my + view[8] * mz + view[11];
    const u = (view[0] * mx + view[1] * my + view[2] * mz + view[9]) / depth;
    const v = (view[3] * mx + view[4] * my + view[5] * mz + view[10]) / depth;
    const lu = Math.min(Math.max(u, lowX), highX);
    const lv = Math.min(Math.max(v, lowY), highY);
    // Sums over the axes of products of what they are on the screen, and the squared cross product, pair by pair.
    let xx = 0, xy = 0, yy = 0, across = 0, m0 = 0, n0 = 0, m1 = 0, n1 = 0;
    for (let a = at + 4; a < at + 16; a += 4) {
      const [ax, ay, az] = [geometry[a], geometry[a + 1], geometry[a + 2]];
      const along = view[6] * ax + view[7] * ay + view[8] * az;
      const m = (fx / depth) * (view[0] * ax + view[1] * ay + view[2] * az - lu * along);
      const n = (fy / depth) * (view[3] * ax + view[4] * ay + view[5] * az - lv * along);
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
    const { rotation, shift } = poses[object];
    sum.point = add(sum.point, times(weight, add(apply(rotation, [mx, my, mz]), shift)));
    found.set(object, sum);
  }
  const best = [...found.values()].reduce((a, b) => (b.weight > (a?.weight ?? 0) ? b : a), null);
  // A veil over nothing is not a thing to hold on to.
  if (!best || 1 - transmittance < 0.1) return null;
  return { object: best.object, share: best.weight, point: times(1 / best.weight, best.point) };
}
