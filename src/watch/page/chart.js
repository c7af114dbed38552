// Small curves.

const WIDTH = 140;
const HEIGHT = 86;
const SIDE = 30; // of numbers beside the curve
const FOOT = 12; // and of those below it
const EDGE = 5; // above the curve, and to its right

function element(name, text, attributes = {}) {
  const made = document.createElement(name);
  if (text !== null) made.textContent = text;
  Object.assign(made, attributes);
  return made;
}

/** A part of a drawing. */
function part(kind, attributes, text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", kind);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
}

const short = new Intl.NumberFormat("en", { notation: "compact", maximumSignificantDigits: 5 });

/** Two to four round numbers within a range, ascending. */
function ticks(low, high) {
  const most = (high - low) / 2;
  const power = 10 ** Math.floor(Math.log10(most));
  const step = [5, 2, 1].find((times) => times * power <= most) * power;
  const numbers = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) numbers.push(k * step + 0);
  return numbers;
}

/** A curve through [x, y] with its name and last value, round numbers beside it, and the first and the last step below. */
function chart(name, points, written) {
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const [left, right] = [0, Math.max(...xs)];
  const [low, high] = [Math.min(...ys), Math.max(...ys)];
  const across = (x) => SIDE + (right > left ? (x - left) / (right - left) : 1) * (WIDTH - SIDE - EDGE);
  const floor = HEIGHT - FOOT;
  const down = (y) => floor - EDGE - (high > low ? (y - low) / (high - low) : 0.5) * (floor - 2 * EDGE);
  const svg = part("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `${name}: ${written(low)} to ${written(high)}` });
  for (const y of high > low ? ticks(low, high) : [low]) {
    const at = down(y).toFixed(1);
    svg.append(part("line", { x1: SIDE, x2: WIDTH, y1: at, y2: at }), part("text", { x: SIDE - 4, y: at, class: "side" }, short.format(y)));
  }
  svg.append(part("line", { x1: SIDE, x2: WIDTH, y1: floor, y2: floor, class: "floor" }));
  for (const x of new Set([left, right])) svg.append(part("text", { x: across(x), y: HEIGHT - 2, class: x > left ? "end" : "" }, x.toLocaleString("en")));
  svg.append(part("polyline", { points: points.map(([x, y]) => `${across(x).toFixed(1)},${down(y).toFixed(1)}`).join(" ") }));
  const head = element("p", null);
  head.append(element("span", name, { className: "quiet" }), element("span", written(ys.at(-1))));
  const box = element("div", null, { className: "chart" });
  box.append(head, svg);
  return box;
}
