// The object at a point of the picture, by the weights that blending gives each Gaussian there.

/**
 * The object with the largest share of the point (x, y) of the camera's image, and where it is: the mean centre of its
 * Gaussians, by weight. `row` is the Gaussian with the largest share, and `coverage` that of all. Nothing where no Gaussian has a
 * share.
 */
function pick(scene, order, state, camera, x, y) {
  const { geometry } = scene;
  const projection = new Projection(scene, state, camera);
  const found = new Map();
  let transmittance = 1;
  let heaviest = { row: null, weight: 0 };
  for (let k = order.length - 1; k >= 0 && transmittance > 1e-3; k--) {
    const i = order.drawn[k];
    projection.ellipse(i);
    const alpha = projection.alpha(x, y);
    if (!alpha) continue;
    const weight = transmittance * alpha;
    transmittance *= 1 - alpha;
    if (weight > heaviest.weight) heaviest = { row: i, weight };
    const { object, pose } = state.parts[state.partOf[i]];
    const sum = found.get(object) ?? { object, weight: 0, point: [0, 0, 0] };
    sum.weight += weight;
    const mean = [0, 1, 2].map((c) => geometry[FLOATS * i + c]);
    sum.point = add(sum.point, times(weight, add(apply(pose.rotation, mean), pose.shift)));
    found.set(object, sum);
  }
  const best = [...found.values()].reduce((a, b) => (b.weight > (a?.weight ?? 0) ? b : a), null);
  // A veil over nothing is not a thing to hold on to.
  if (!best || 1 - transmittance < 0.1) return null;
  const point = times(1 / best.weight, best.point);
  return { object: best.object, share: best.weight, point, row: heaviest.row, coverage: 1 - transmittance };
}
