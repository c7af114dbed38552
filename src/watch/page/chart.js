// Small curves.

const WIDTH = 140;
const HEIGHT = 60;

function element(name, text, attributes = {}) {
  const made = document.createElement(name);
  if (text !== null) made.textContent = text;
  Object.assign(made, attributes);
  return made;
}

/** A curve through [x, y] with its name and last value, and its smallest and largest value beside the axis. */
function chart(name, points, written) {
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const [left, right] = [0, Math.max(...xs)];
  const [low, high] = [Math.min(...ys), Math.max(...ys)];
  const place = ([x, y]) => {
    const across = right > left ? (x - left) / (right - left) : 1;
    const up = high > low ? (y - low) / (high - low) : 0.5;
    return `${(across * WIDTH).toFixed(1)},${(HEIGHT - 2 - up * (HEIGHT - 4)).toFixed(1)}`;
  };
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", `${name}: ${written(low)} to ${written(high)}`);
  const line = document.createElementNS(svg.namespaceURI, "polyline");
  line.setAttribute("points", points.map(place).join(" "));
  const floor = document.createElementNS(svg.namespaceURI, "line");
  for (const [key, value] of Object.entries({ x1: 0, x2: WIDTH, y1: HEIGHT, y2: HEIGHT })) floor.setAttribute(key, value);
  svg.append(floor, line);
  const head = element("p", null);
  head.append(element("span", name, { className: "quiet" }), element("span", written(ys.at(-1))));
  const box = element("div", null, { className: "chart" });
  box.append(head, svg);
  return box;
}
