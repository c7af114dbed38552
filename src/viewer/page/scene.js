// The scene: a header, and columns of numbers as `packing.rs` writes them, which the page carries or its server has.

const LOG_STEP = 1 / 1024; // of logarithms of lengths and of colour scales
const BASE_STEP = 1 / 1024; // of the constant term of a colour
const TEXELS = 4; // that a Gaussian takes in each texture
const FLOATS = 4 * TEXELS;
const TEXTURE_WIDTH = 2048; // as in splat.vert

/** A Gaussian's row in `geometry`: centre and opacity, then three axes as long as their standard deviations. */
const OPACITY = 3;
/** The id of the one object of a scene without labels. */
const WHOLE = -1;

/** Cosine beyond which an axis of the world is upright. */
const UPRIGHT = 0.999999;
const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };

class Scene {
  /** What objects turn about, counter-clockwise from above: up, with its name. */
  get upright() {
    const axis = Object.keys(AXES).find((name) => Math.abs(dot(AXES[name], this.up)) > UPRIGHT);
    if (!axis) return { name: "up", direction: unit(this.up) };
    const sign = Math.sign(dot(AXES[axis], this.up));
    return { name: `${sign > 0 ? "" : "\u2212"}${axis}`, direction: times(sign, AXES[axis]) };
  }

  /** @param {object} header what `Header` of mod.rs is */
  constructor(header) {
    Object.assign(this, header);
    /** Whether Gaussians have labels; without them all are one nameless object. */
    this.labelled = this.objects[0].id !== null;
    if (!this.labelled) this.objects[0].id = WHOLE;
    const rowsOf = (count) => Math.ceil((TEXELS * count) / TEXTURE_WIDTH);
    /** Blocks in which Gaussians come, how many have come, and rows of a texture that each one takes. */
    this.steps = Math.max(1, this.blocks);
    this.received = 0;
    this.blockRows = rowsOf(Math.ceil(this.gaussians / this.steps));
    const words = 4 * TEXTURE_WIDTH * rowsOf(this.gaussians);
    /** Rows of 16 floats, see above; the texture of the same name has them block by block. */
    this.geometry = new Float32Array(words);
    /** Rows of 16 words: 45 signed bytes of view-dependent colour, then the base colour as three floats. */
    this.colours = new Uint32Array(words);
    /** The group of neighbours on one surface of each Gaussian; none without labels, on watched pages, and before it is there. */
    this.superpoints = null;
  }

  /** The tree of `regions` regions. The first of them are the superpoints. */
  setTree(columns, regions) {
    this.superpoints = columns.take(Uint32Array, this.gaussians);
    this.parents = columns.take(Uint32Array, regions);
    this.heights = columns.take(Float32Array, regions);
    this.prominences = columns.take(Float32Array, regions);
  }

  setPlaces(columns) {
    const means = columns.take(Float32Array, 3 * this.gaussians);
    for (let i = 0; i < this.gaussians; i++) {
      for (let k = 0; k < 3; k++) this.geometry[FLOATS * i + k] = means[3 * i + k];
    }
    /** The place of each Gaussian's object in the list. */
    this.places = columns.take(Uint16Array, this.gaussians);
  }

  /** What the Gaussians `first`, `first + step` and so on look like. Until then they are transparent. */
  setLooks(columns, first, step) {
    const count = Math.ceil((this.gaussians - first) / step);
    const terms = (this.degree + 1) ** 2 - 1;
    const scales = columns.take(Int16Array, 3 * count);
    const base = columns.take(Int16Array, 3 * count);
    const rotations = columns.take(Int16Array, 4 * count);
    const opacities = columns.take(Uint16Array, count);
    const spread = columns.take(Int16Array, count);
    const rest = columns.take(Int8Array, 3 * terms * count);
    const bytes = new Int8Array(this.colours.buffer);
    const floats = new Float32Array(this.colours.buffer);
    for (let i = 0, row = FLOATS * first; i < count; i++, row += FLOATS * step) {
      for (let k = 0; k < 3; k++) floats[row + 12 + k] = base[3 * i + k] * BASE_STEP;
      this.geometry[row + OPACITY] = opacities[i] / 65535;
      this.setAxes(row, rotations, 4 * i, scales, 3 * i);
      this.geometry[row + 11] = terms ? Math.exp(spread[i] * LOG_STEP) / 127 : 0;
      for (let k = 0; k < 3 * terms; k++) bytes[4 * row + k] = rest[3 * terms * i + k];
    }
    this.received = first + 1;
  }

  /** Whole rows of a texture with what a column of numbers has of a block. */
  block(column, first) {
    if (this.steps === 1) return column;
    const out = new column.constructor(4 * TEXTURE_WIDTH * this.blockRows);
    for (let from = FLOATS * first, to = 0; from < FLOATS * this.gaussians; from += FLOATS * this.steps, to += FLOATS) {
      for (let k = 0; k < FLOATS; k++) out[to + k] = column[from + k];
    }
    return out;
  }

  /** Columns of the rotation (w, x, y, z), each as long as its standard deviation. */
  setAxes(row, rotations, q, scales, s) {
    const [w, x, y, z] = [rotations[q], rotations[q + 1], rotations[q + 2], rotations[q + 3]];
    const twice = 2 / Math.max(w * w + x * x + y * y + z * z, 1);
    const [a, b, c] = [0, 1, 2].map((j) => Math.exp(scales[s + j] * LOG_STEP));
    const out = this.geometry;
    out[row + 4] = a * (1 - twice * (y * y + z * z));
    out[row + 5] = a * twice * (x * y + w * z);
    out[row + 6] = a * twice * (x * z - w * y);
    out[row + 8] = b * twice * (x * y - w * z);
    out[row + 9] = b * (1 - twice * (x * x + z * z));
    out[row + 10] = b * twice * (y * z + w * x);
    out[row + 12] = c * twice * (x * z + w * y);
    out[row + 13] = c * twice * (y * z - w * x);
    out[row + 14] = c * (1 - twice * (x * x + y * y));
  }

  /** Takes what the page carries. */
  setEmbedded() {
    const bytes = new Uint8Array(this.bytes);
    let at = 0;
    for (const part of document.querySelectorAll("script.columns")) {
      const some = decoded(part.textContent.trim());
      bytes.set(some, at);
      at += some.length;
      part.remove();
    }
    if (at !== bytes.length) throw new Error("the page is cut off");
    const columns = new Columns(bytes.buffer);
    if (this.regions) this.setTree(columns, this.regions);
    this.setPlaces(columns);
    this.setLooks(columns, 0, 1);
  }
}

/** Columns of numbers, one after the other. */
class Columns {
  constructor(buffer) {
    this.buffer = buffer;
    this.at = 0;
  }

  take(Type, count) {
    const column = new Type(this.buffer, this.at, count);
    this.at += column.byteLength;
    return column;
  }
}

/** Bytes of base64. */
function decoded(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const characters = atob(text);
  const bytes = new Uint8Array(characters.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = characters.charCodeAt(i);
  return bytes;
}
