// The scene that the page carries: a header, and columns of numbers as `packing.rs` writes them.

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

  /**
   * @param {object} header what `Header` of mod.rs is
   * @param {ArrayBuffer} buffer the columns
   */
  constructor(header, buffer) {
    Object.assign(this, header);
    /** Whether Gaussians have labels; without them all are one nameless object. */
    this.labelled = this.objects[0].id !== null;
    if (!this.labelled) this.objects[0].id = WHOLE;
    const n = this.gaussians;
    const terms = (this.degree + 1) ** 2 - 1;
    let at = 0;
    const take = (Type, width, rows = n) => {
      const column = new Type(buffer, at, width * rows);
      at += column.byteLength;
      return column;
    };
    const means = take(Float32Array, 3);
    /** The group of neighbours on one surface of each Gaussian. */
    this.superpoints = this.labelled ? take(Uint32Array, 1) : null;
    /** The tree that superpoints merge into, see regions.rs: they are its first regions. */
    this.parents = take(Uint32Array, 1, this.regions);
    this.heights = take(Float32Array, 1, this.regions);
    this.prominences = take(Float32Array, 1, this.regions);
    const scales = take(Int16Array, 3);
    const base = take(Int16Array, 3);
    const rotations = take(Int16Array, 4);
    const opacities = take(Uint16Array, 1);
    /** The place of each Gaussian's object in the list. */
    this.places = take(Uint16Array, 1);
    const spread = take(Int16Array, 1);
    const rest = take(Int8Array, 3 * terms);

    this.rows = Math.max(1, Math.ceil((TEXELS * n) / TEXTURE_WIDTH));
    /** Rows of 16 floats, see above; the texture of the same name. */
    this.geometry = new Float32Array(4 * TEXTURE_WIDTH * this.rows);
    /** Rows of 16 words: 45 signed bytes of view-dependent colour, then the base colour as three floats. */
    this.colours = new Uint32Array(4 * TEXTURE_WIDTH * this.rows);
    const bytes = new Int8Array(this.colours.buffer);
    const floats = new Float32Array(this.colours.buffer);
    for (let i = 0, row = 0; i < n; i++, row += FLOATS) {
      for (let k = 0; k < 3; k++) {
        this.geometry[row + k] = means[3 * i + k];
        floats[row + 12 + k] = base[3 * i + k] * BASE_STEP;
      }
      this.geometry[row + OPACITY] = opacities[i] / 65535;
      this.setAxes(row, rotations, 4 * i, scales, 3 * i);
      this.geometry[row + 11] = terms ? Math.exp(spread[i] * LOG_STEP) / 127 : 0;
      const bytesAt = 4 * row - 3 * terms * i;
      for (let k = 3 * terms * i; k < 3 * terms * (i + 1); k++) bytes[bytesAt + k] = rest[k];
    }
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

  /** The scene in the page. */
  static embedded() {
    const header = JSON.parse(document.getElementById("header").textContent);
    const bytes = new Uint8Array(header.bytes);
    let at = 0;
    for (const part of document.querySelectorAll("script.columns")) {
      const some = decoded(part.textContent.trim());
      bytes.set(some, at);
      at += some.length;
      part.remove();
    }
    if (at !== bytes.length) throw new Error("the page is cut off");
    return new Scene(header, bytes.buffer);
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
