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

  /** Sorts what is shown and lies before the camera. */
  sort(camera, objects) {
    const { geometry, gaussians } = this.scene;
    const [fx, fy, fz] = camera.forward;
    const shift = objects.map((object) => dot(camera.forward, minus(object.offset, camera.center)));
    const depths = new Float32Array(this.keys.buffer);
    let count = 0;
    for (let i = 0, at = 0; i < gaussians; i++, at += FLOATS) {
      const object = geometry[at + OBJECT];
      const depth = fx * geometry[at] + fy * geometry[at + 1] + fz * geometry[at + 2] + shift[object];
      if (depth > NEAR && objects[object].shown) {
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
