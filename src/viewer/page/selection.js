// The Gaussians that are selected, and what shapes on the screen take.

class Selection {
  constructor(count) {
    this.flags = new Uint8Array(count);
    this.count = 0;
    /** Gaussians under the points that it grew from, how it grew, and how far. */
    this.seeds = [];
    this.growth = null;
    this.level = 0;
    /** What was selected when it began to grow, if that stays, and whether growth adds to it (1) or takes from it (0). */
    this.base = null;
    this.flag = 1;
  }

  set(row, flag) {
    this.count += flag - this.flags[row];
    this.flags[row] = flag;
  }

  clear() {
    this.flags.fill(0);
    this.count = 0;
    this.endGrowth();
  }

  /** What `restore` takes back: runs, which are small, and the flags that growth began from. */
  copy() {
    const { seeds, growth, level, base, flag } = this;
    return { runs: runsOf(this.rows()), growing: { seeds, growth, level, base, flag } };
  }

  restore({ runs, growing }) {
    this.clear();
    for (const row of rowsOf(runs)) this.set(row, 1);
    Object.assign(this, growing);
  }

  /** A plain click ("new") adds a point to what grows. With Shift or Alt, growth begins anew on top of the selection. */
  plant(row, scene, how) {
    const seeds = how === "new" ? [...this.seeds, row] : [row];
    if (how !== "new" || !this.growth) {
      this.base = how === "new" ? null : this.flags.slice();
      this.flag = how === "subtract" ? 0 : 1;
    }
    this.seeds = seeds;
    this.growth = new Growth(scene, seeds);
  }

  /** What is selected stays; the next point begins anew. */
  endGrowth() {
    this.seeds = [];
    this.growth = null;
    this.base = null;
  }

  /** Drops Gaussians that are deleted. */
  restrict(state) {
    const gone = this.rows().filter((row) => state.objectOf(row) === null);
    for (const row of gone) this.set(row, 0);
    if (gone.length) this.endGrowth();
  }

  /** Ascending. */
  rows() {
    if (!this.count) return [];
    const rows = [];
    for (let i = 0; i < this.flags.length && rows.length < this.count; i++) if (this.flags[i]) rows.push(i);
    return rows;
  }

  /** Objects of the selected Gaussians, the most frequent first. */
  objects(state) {
    const counts = new Map();
    for (const row of this.rows()) {
      const id = state.objectOf(row);
      counts.set(id, (counts.get(id) ?? 0) + 1);
    }
    return [...counts].sort((a, b) => b[1] - a[1]).map(([id]) => id);
  }
}

/**
 * Gaussians that a shape can take, with their places on the screen: those that are drawn, lie no deeper than `limit` behind the
 * surface, and belong to one of the objects `within`, if there are any.
 */
function candidates(scene, order, state, camera, surface, limit, within) {
  const projection = new Projection(scene, state, camera);
  const found = [];
  for (let k = 0; k < order.length; k++) {
    const row = order.drawn[k];
    if (within.size && !within.has(state.objectOf(row))) continue;
    projection.place(row);
    const { x, y, depth } = projection;
    if (depth <= surface.at(x, y) + limit) found.push({ row, x, y });
  }
  return found;
}

/** Whether a point is within `radius` of the line from a to b. */
function nearLine([x, y], a, b, radius) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const along = Math.max(0, Math.min(1, ((x - a[0]) * dx + (y - a[1]) * dy) / Math.max(dx * dx + dy * dy, 1e-9)));
  return Math.hypot(x - a[0] - along * dx, y - a[1] - along * dy) <= radius;
}

/** Whether a point is inside a polygon, by the parity of the edges to its right. */
function insidePolygon([x, y], corners) {
  let inside = false;
  corners.forEach(([ax, ay], i) => {
    const [bx, by] = corners.at(i - 1);
    if (ay > y !== by > y && x < ax + ((bx - ax) * (y - ay)) / (by - ay)) inside = !inside;
  });
  return inside;
}
