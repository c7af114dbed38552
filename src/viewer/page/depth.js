// How far off the surface is that the picture shows, in cells.

const CELL = 8; // pixels
const HALF = 0.5; // transmittance at which the surface lies

class DepthGrid {
  /** Blends the Gaussians of `order` from the nearest at the middle of each cell. */
  constructor(scene, order, state, camera) {
    this.wide = Math.ceil(camera.width / CELL);
    this.high = Math.ceil(camera.height / CELL);
    const cells = this.wide * this.high;
    /** Of the Gaussian with which transmittance falls to a half, or else of the one that weighs most. */
    this.depths = new Float32Array(cells).fill(Infinity);
    const left = new Float32Array(cells).fill(1);
    const heaviest = new Float32Array(cells);
    const projection = new Projection(scene, state, camera);
    let open = cells;
    for (let k = order.length - 1; k >= 0 && open > 0; k--) {
      const i = order.drawn[k];
      projection.ellipse(i);
      const reach = 2 * Math.log(projection.opacity / ALPHA_MIN);
      if (!(reach > 0)) continue;
      const [spanX, spanY] = [Math.sqrt(reach * projection.xx), Math.sqrt(reach * projection.yy)];
      const [left0, right0] = this.range(projection.x, spanX, this.wide);
      const [top, bottom] = this.range(projection.y, spanY, this.high);
      for (let row = top; row <= bottom; row++) {
        for (let column = left0; column <= right0; column++) {
          const cell = row * this.wide + column;
          if (left[cell] <= HALF) continue;
          const alpha = projection.alpha((column + 0.5) * CELL, (row + 0.5) * CELL);
          const weight = left[cell] * alpha;
          left[cell] -= weight;
          const isSurface = left[cell] <= HALF;
          if (isSurface) open--;
          if (isSurface || weight > heaviest[cell]) {
            heaviest[cell] = weight;
            this.depths[cell] = projection.depth;
          }
        }
      }
    }
  }

  /** Cells whose middle is within `span` of a place. */
  range(at, span, most) {
    return [Math.max(0, Math.ceil((at - span) / CELL - 0.5)), Math.min(most - 1, Math.floor((at + span) / CELL - 0.5))];
  }

  /** The depth at a point of the picture; undefined beyond its edges. */
  at(x, y) {
    const [column, row] = [Math.floor(x / CELL), Math.floor(y / CELL)];
    const isInside = column >= 0 && row >= 0 && column < this.wide && row < this.high;
    return isInside ? this.depths[row * this.wide + column] : undefined;
  }
}
