// What a few points on a thing select: the regions that hold them, as select.rs grows them.

class Growth {
  /** From the Gaussians `seeds`, one or more. */
  constructor(scene, seeds) {
    this.scene = scene;
    const ancestors = seeds.map((seed) => this.around(scene.superpoints[seed]));
    const heights = ancestors.flat().map((region) => scene.heights[region]);
    /** Thresholds at which the selection changes, ascending. */
    this.levels = Float32Array.from(new Set(heights)).sort();
    /** The threshold at which each region is in one with a seed. */
    this.reached = this.reachedFrom(ancestors);
    this.proposed = this.levels.indexOf(this.propose(ancestors));
  }

  /** The regions that hold a region, from itself up. */
  around(region) {
    const { parents } = this.scene;
    const around = [region];
    while (parents[region] !== region) around.push((region = parents[region]));
    return around;
  }

  reachedFrom(ancestors) {
    const { parents, heights } = this.scene;
    const reached = new Float32Array(parents.length).fill(Infinity);
    for (const region of ancestors.flat()) reached[region] = heights[region];
    // Parents come after their parts.
    for (let region = parents.length - 1; region >= 0; region--) {
      reached[region] = Math.min(reached[region], reached[parents[region]]);
    }
    return reached;
  }

  /** The height of the region that stands out most of those that hold all seeds. */
  propose(ancestors) {
    const { heights, prominences } = this.scene;
    const others = ancestors.slice(1).map((regions) => new Set(regions));
    const shared = ancestors[0].filter((region) => others.every((regions) => regions.has(region)));
    if (!shared.length) return Math.max(...ancestors.map((regions) => this.propose([regions])));
    return heights[shared.reduce((best, region) => (prominences[region] > prominences[best] ? region : best))];
  }

  /** Whether a Gaussian is in the selection at a level. */
  holds(row, level) {
    return this.reached[this.scene.superpoints[row]] <= this.levels[level];
  }
}
