// Gaussians from the farthest to the nearest, by a radix sort of their depths.

const DIGIT = 65536;

class DepthOrder {
  constructor(scene) {
    this.scene = scene;
    const n = scene.gaussians;
    this.keys = new Uint32Array(n);
    this.ids = new Uint32Array(n);
    this.spare = new Uint32Array(n);
    /** Drawn in this order, `length` of them. */
    this.drawn = new Uint32Array(n);
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
    const depths = new Float32Array(this.keys.buffer);
    let count = 0;
    for (let i = 0, at = 0; i < gaussians; i++, at += FLOATS) {
      const p = 4 * partOf[i];
      const depth =
        planes[p] * geometry[at] + planes[p + 1] * geometry[at + 1] + planes[p + 2] * geometry[at + 2] + planes[p + 3];
      if (depth > NEAR && shown[partOf[i]] && geometry[at + OPACITY] > 0) {
        // Bits of positive floats are ordered as they are.
        depths[i] = depth;
        this.ids[count++] = i;
      }
    }
    this.pass(this.ids, this.spare, count, 0);
    this.pass(this.spare, this.ids, count, 16);
    for (let k = 0; k < count; k++) this.drawn[k] = this.ids[count - 1 - k];
    this.length = count;
  }

  /** One stable pass, ascending by 16 bits. */
  pass(from, to, count, shift) {
    const starts = new Uint32Array(DIGIT + 1);
    for (let k = 0; k < count; k++) starts[((this.keys[from[k]] >>> shift) & (DIGIT - 1)) + 1]++;
    for (let d = 0; d < DIGIT; d++) starts[d + 1] += starts[d];
    for (let k = 0; k < count; k++) to[starts[(this.keys[from[k]] >>> shift) & (DIGIT - 1)]++] = from[k];
  }
}
