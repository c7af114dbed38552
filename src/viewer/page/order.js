// Gaussians from the farthest to the nearest, by a radix sort of their depths.

const DIGIT = 65536;

class DepthOrder {
  constructor(scene) {
    this.scene = scene;
    const n = scene.gaussians;
    /** Depths and Gaussians, and the same after a pass. */
    [this.depths, this.ids, this.otherDepths, this.otherIds] = [0, 1, 2, 3].map(() => new Uint32Array(n));
    /** Drawn in this order, `length` of them; whole rows of a texture. */
    this.drawn = new Uint32Array(Math.ceil(n / TEXTURE_WIDTH) * TEXTURE_WIDTH);
    this.length = 0;
  }

  /** Sorts what is there, is shown and lies before the camera. */
  sort(camera, state) {
    const { geometry, gaussians } = this.scene;
    const { parts, partOf } = state;
    // The depth of a point of each part: four numbers.
    const planes = new Float64Array(4 * parts.length);
    parts.forEach(({ pose }, i) => {
      planes.set(apply(transpose(pose.rotation), camera.forward), 4 * i);
      planes[4 * i + 3] = dot(camera.forward, minus(pose.shift, camera.center));
    });
    const shown = Uint8Array.from(parts, (part) => state.isShown(part));
    const depths = new Float32Array(this.depths.buffer);
    let count = 0;
    for (let i = 0, at = 0; i < gaussians; i++, at += FLOATS) {
      const p = 4 * partOf[i];
      const depth =
        planes[p] * geometry[at] + planes[p + 1] * geometry[at + 1] + planes[p + 2] * geometry[at + 2] + planes[p + 3];
      if (depth > NEAR && shown[partOf[i]] && geometry[at + OPACITY] > 0) {
        // Bits of positive floats are ordered as they are.
        depths[count] = depth;
        this.ids[count++] = i;
      }
    }
    const [here, there] = [[this.depths, this.ids], [this.otherDepths, this.otherIds]];
    this.pass(here, there, count, 0);
    this.pass(there, here, count, 16);
    for (let k = 0; k < count; k++) this.drawn[k] = this.ids[count - 1 - k];
    this.length = count;
  }

  /** One stable pass, ascending by 16 bits of the depths. Depths go along: to look them up again would take longer. */
  pass([depths, ids], [sortedDepths, sortedIds], count, shift) {
    const starts = new Uint32Array(DIGIT + 1);
    for (let k = 0; k < count; k++) starts[((depths[k] >>> shift) & (DIGIT - 1)) + 1]++;
    for (let d = 0; d < DIGIT; d++) starts[d + 1] += starts[d];
    for (let k = 0; k < count; k++) {
      const place = starts[(depths[k] >>> shift) & (DIGIT - 1)]++;
      sortedDepths[place] = depths[k];
      sortedIds[place] = ids[k];
    }
  }
}
