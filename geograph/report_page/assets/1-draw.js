// Small helpers of all pictures. Texts are set as texts, never as markup.

const NAMESPACE = "http://www.w3.org/2000/svg";
const INK = "#222222", FAINT = "#6b6b6b", GRID = "#e2e2e2", PATH = "#0072B2", BAND = "#9fd2f2";
// Radii of 95 % of a normal distribution in the plane and in space, in standard deviations.
const RADIUS_PLANE = 2.4477468306808161, RADIUS_SPACE = 2.7954834829151074;

function shape(name, attributes, parent) {
  const element = document.createElementNS(NAMESPACE, name);
  for (const key in attributes) element.setAttribute(key, attributes[key]);
  if (parent) parent.appendChild(element);
  return element;
}

function label(parent, x, y, text, attributes) {
  const element = shape("text", { x, y, ...attributes }, parent);
  element.textContent = text;
  return element;
}

function tip(element, text) {
  shape("title", {}, element).textContent = text;
  return element;
}

function element(name, className, text, parent) {
  const made = document.createElement(name);
  if (className) made.className = className;
  if (text) made.textContent = text;
  if (parent) parent.appendChild(made);
  return made;
}

/** The round step (1, 2 or 5 times a power of ten) that divides a span into about so many parts. */
function roundStep(span, wanted) {
  if (!(span > 0)) return 1;
  const rough = span / Math.max(wanted, 1);
  const decade = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].find((part) => part * decade >= rough * 0.999) * decade;
}

function multiples(low, high, step) {
  const found = [];
  const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
  for (let index = first; index <= last && found.length < 100; index++) found.push(index * step);
  return found;
}

function numberText(value, step) {
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const plain = decimals > 6 || Math.abs(value) >= 1e7
    ? value.toPrecision(3) : value.toFixed(decimals);
  return (Number(plain) === 0 ? plain.replace("-", "") : plain).replace("-", "\u2212");
}

function lengthText(metres) {
  if (metres >= 1000) return `${numberText(metres / 1000, 1)} km`;
  return metres >= 1 ? `${numberText(metres, 1)} m` : `${numberText(metres * 1000, 1)} mm`;
}

function spanOf(lists) {
  let low = Infinity, high = -Infinity;
  for (const list of lists) {
    for (const value of list) {
      if (value === null) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  return [low, high];
}

/** The outline of a marker around a point, as a piece of an SVG path. */
function markerPath(marker, x, y, size) {
  const s = size, at = (dx, dy) => `${(x + dx).toFixed(1)},${(y + dy).toFixed(1)}`;
  const ring = (points) => `M${points.map(([dx, dy]) => at(dx * s, dy * s)).join("L")}Z`;
  switch (marker) {
    case "^": return ring([[0, -1.15], [1.05, 0.8], [-1.05, 0.8]]);
    case "v": return ring([[0, 1.15], [1.05, -0.8], [-1.05, -0.8]]);
    case "s": return ring([[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]]);
    case "D": return ring([[0, -1.2], [1.2, 0], [0, 1.2], [-1.2, 0]]);
    case "P": return ring([[-0.35, -1], [0.35, -1], [0.35, -0.35], [1, -0.35], [1, 0.35],
      [0.35, 0.35], [0.35, 1], [-0.35, 1], [-0.35, 0.35], [-1, 0.35], [-1, -0.35],
      [-0.35, -0.35]]);
    case "X": return ring([[-1, -0.6], [-0.6, -1], [0, -0.4], [0.6, -1], [1, -0.6], [0.4, 0],
      [1, 0.6], [0.6, 1], [0, 0.4], [-0.6, 1], [-1, 0.6], [-0.4, 0]]);
    case "x": return `M${at(-s, -s)}L${at(s, s)}M${at(-s, s)}L${at(s, -s)}`;
    default: return `M${at(-s, 0)}a${s},${s} 0 1,0 ${2 * s},0a${s},${s} 0 1,0 ${-2 * s},0Z`;
  }
}

/** Semi-axes and turn of the ellipse of a 2 by 2 covariance; null where there is none. */
function ellipseOf(xx, xy, yy, radius) {
  if (xx === null || xy === null || yy === null) return null;
  const middle = (xx + yy) / 2, apart = Math.hypot((xx - yy) / 2, xy);
  return {
    major: radius * Math.sqrt(Math.max(middle + apart, 0)),
    minor: radius * Math.sqrt(Math.max(middle - apart, 0)),
    turn: 0.5 * Math.atan2(2 * xy, xx - yy),
  };
}

/** Where a sensor is at a time: [x, y, z], on a straight line between its known places. */
function placeAt(sensor, time) {
  const known = sensor.time, last = known.length - 1;
  let next = 0;
  while (next <= last && known[next] < time) next++;
  if (next === 0 || next > last) return sensor.xyz.map((axis) => axis[Math.min(next, last)]);
  const share = (time - known[next - 1]) / (known[next] - known[next - 1]);
  return sensor.xyz.map((axis) => axis[next - 1] + share * (axis[next] - axis[next - 1]));
}

function legend(host, entries) {
  const list = element("ul", "legend", "", host);
  for (const entry of entries) {
    const row = element("li", "", "", list);
    const drawing = shape("svg", { viewBox: "0 0 22 12", width: 22, height: 12,
      "aria-hidden": "true" }, row);
    if (entry.kind === "band" || entry.kind === "levels") {
      shape("rect", { x: 1, y: 1, width: 20, height: 10, fill: entry.colour,
        stroke: entry.edge || "none", "fill-opacity": entry.opacity || 1 }, drawing);
    } else if (entry.kind === "points") {
      const cross = entry.marker === "x";
      shape("path", { d: markerPath(entry.marker, 11, 6, 4), fill: cross ? "none" : entry.colour,
        stroke: entry.edge || entry.colour, "stroke-width": cross ? 1.6 : 0.8 }, drawing);
    } else {
      shape("line", { x1: 0, x2: 22, y1: 6, y2: 6, stroke: entry.colour,
        "stroke-width": entry.width || 1.4,
        "stroke-dasharray": entry.dash || entry.kind === "level" ? "5 3" : "none" }, drawing);
    }
    row.appendChild(document.createTextNode(entry.label));
  }
}
