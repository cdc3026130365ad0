// A chart against time, from its description (geograph/report_page/charts.py).

let clips = 0;

function chartRanges(spec) {
  const xs = [], ys = [];
  for (const layer of spec.layers) {
    if (layer.x) xs.push(layer.x);
    if (layer.kind === "band") ys.push(layer.low, layer.high);
    else if (layer.kind === "level") ys.push([layer.y]);
    else if (layer.y) ys.push(layer.y);
  }
  let [left, right] = spec.x_range || spanOf(xs);
  let [low, high] = spec.y_range || spanOf(ys);
  if (!(left <= right)) [left, right] = [0, 1];
  if (!(low <= high)) [low, high] = [0, 1];
  if (left === right) [left, right] = [left - 1, right + 1];
  if (!spec.y_range) {
    const margin = 0.06 * (high - low) || Math.abs(high) * 0.1 || 1;
    low = spec.y_low === undefined ? low - margin : spec.y_low;
    high += margin;
  }
  const margin = 0.01 * (right - left);
  return { left: left - margin, right: right + margin, low, high };
}

function drawChart(host, spec) {
  host.textContent = "";
  const width = Math.max(220, host.clientWidth), height = spec.height || 190;
  const range = chartRanges(spec);
  const yStep = roundStep(range.high - range.low, 5);
  const yTicks = multiples(range.low, range.high, yStep);
  const longest = Math.max(...yTicks.map((value) => numberText(value, yStep).length), 1);
  const box = { left: 14 + 6.6 * longest, right: width - 8, top: 8, bottom: height - 36 };
  const atX = (x) => box.left + (x - range.left) / (range.right - range.left) * (box.right - box.left);
  const held = (y) => spec.clamp ? Math.min(Math.max(y, range.low), range.high) : y;
  const atY = (y) => box.bottom - (held(y) - range.low) / (range.high - range.low) * (box.bottom - box.top);

  const caption = element("figcaption", "", "", host);
  element("b", "", spec.title, caption);
  element("span", "", ` ${spec.note || spec.y}`, caption);
  const root = shape("svg", { viewBox: `0 0 ${width} ${height}`, role: "img",
    "aria-label": `${spec.title}: ${spec.y} against ${spec.x}`, class: "chart" }, host);
  const clip = `clip${clips++}`;
  // A little beyond the axes, so that markers at the edge are whole.
  shape("rect", { x: box.left - 4, y: box.top - 5, width: box.right - box.left + 9,
    height: box.bottom - box.top + 10 }, shape("clipPath", { id: clip }, root));
  drawAxes(root, spec, range, box, { atX, atY, yStep, yTicks });
  const inside = shape("g", { "clip-path": `url(#${clip})` }, root);
  for (const layer of spec.layers) drawLayer(inside, layer, { atX, atY, box });
  const cursor = shape("line", { y1: box.top, y2: box.bottom, stroke: INK, "stroke-width": 1,
    "stroke-opacity": 0, class: "cursor" }, inside);
  legend(host, spec.layers.filter((layer) => layer.label));
  return (time) => {
    cursor.setAttribute("x1", atX(time));
    cursor.setAttribute("x2", atX(time));
    cursor.setAttribute("stroke-opacity", 0.5);
  };
}

function drawAxes(root, spec, range, box, { atX, atY, yStep, yTicks }) {
  for (const value of yTicks) {
    shape("line", { x1: box.left, x2: box.right, y1: atY(value), y2: atY(value), stroke: GRID }, root);
    label(root, box.left - 5, atY(value) + 4, numberText(value, yStep), { "text-anchor": "end" });
  }
  // Times that share their first digits show these once, in the label.
  const span = range.right - range.left;
  const common = Math.max(Math.abs(range.left), Math.abs(range.right)) > 1e4 * span;
  const decade = 10 ** Math.ceil(Math.log10(span) + 1);
  const offset = common ? Math.floor(range.left / decade) * decade : 0;
  const step = roundStep(span, Math.max(2, (box.right - box.left) / 70));
  for (const value of multiples(range.left - offset, range.right - offset, step)) {
    const x = atX(value + offset);
    shape("line", { x1: x, x2: x, y1: box.top, y2: box.bottom, stroke: GRID }, root);
    label(root, x, box.bottom + 15, numberText(value, step), { "text-anchor": "middle" });
  }
  shape("path", { d: `M${box.left},${box.top}V${box.bottom}H${box.right}`, stroke: FAINT,
    fill: "none" }, root);
  const text = offset ? `${spec.x}, less ${offset}` : spec.x;
  label(root, (box.left + box.right) / 2, box.bottom + 31, text, { "text-anchor": "middle" });
}

function linePath(xs, ys, atX, atY) {
  let text = "", open = false;
  xs.forEach((x, row) => {
    if (ys[row] === null) { open = false; return; }
    text += `${open ? "L" : "M"}${atX(x).toFixed(1)},${atY(ys[row]).toFixed(1)}`;
    open = true;
  });
  return text;
}

function bandPath(layer, atX, atY) {
  const parts = [];
  let run = [];
  const close = () => {
    if (run.length) {
      const there = run.map((row) => `${atX(layer.x[row]).toFixed(1)},${atY(layer.high[row]).toFixed(1)}`);
      const back = run.map((row) => `${atX(layer.x[row]).toFixed(1)},${atY(layer.low[row]).toFixed(1)}`);
      parts.push(`M${there.join("L")}L${back.reverse().join("L")}Z`);
    }
    run = [];
  };
  layer.x.forEach((_, row) => {
    if (layer.low[row] === null || layer.high[row] === null) close();
    else run.push(row);
  });
  close();
  return parts.join("");
}

function drawLayer(parent, layer, { atX, atY, box }) {
  if (layer.kind === "band") {
    shape("path", { d: bandPath(layer, atX, atY), fill: layer.colour, "fill-opacity": 0.8 }, parent);
  } else if (layer.kind === "levels") {
    shape("rect", { x: box.left, width: box.right - box.left, y: atY(layer.high),
      height: atY(layer.low) - atY(layer.high), fill: layer.colour }, parent);
  } else if (layer.kind === "level") {
    shape("line", { x1: box.left, x2: box.right, y1: atY(layer.y), y2: atY(layer.y),
      stroke: layer.colour, "stroke-dasharray": "5 3" }, parent);
  } else if (layer.kind === "line") {
    shape("path", { d: linePath(layer.x, layer.y, atX, atY), fill: "none", stroke: layer.colour,
      "stroke-width": layer.width || 1.3, "stroke-dasharray": layer.dash ? "5 3" : "none",
      "stroke-linejoin": "round" }, parent);
  } else if (layer.kind === "points") {
    drawPoints(parent, layer, atX, atY);
  } else if (layer.kind === "names") {
    drawNames(parent, layer, { atX, atY, box });
  }
}

function drawPoints(parent, layer, atX, atY) {
  const size = layer.size || 2.2, cross = layer.marker === "x";
  const outlines = layer.x.map((x, row) => layer.y[row] === null ? ""
    : markerPath(layer.marker, atX(x), atY(layer.y[row]), size));
  shape("path", { d: outlines.join(""), fill: cross ? "none" : layer.colour, "fill-opacity": 0.65,
    stroke: cross ? layer.colour : "none", "stroke-width": 1.5 }, parent);
  (layer.tips || []).forEach((text, row) => {
    if (layer.y[row] === null) return;
    tip(shape("circle", { cx: atX(layer.x[row]), cy: atY(layer.y[row]), r: 8, fill: "transparent" },
      parent), text);
  });
}

function drawNames(parent, layer, { atX, atY, box }) {
  const taken = [];
  layer.names.forEach((name, row) => {
    if (layer.y[row] === null) return;
    const x = atX(layer.x[row]), right = x > (box.left + box.right) / 2;
    let y = Math.min(Math.max(atY(layer.y[row]) + 4, box.top + 11), box.bottom - 4);
    const upper = y < (box.top + box.bottom) / 2;
    while (taken.some(([a, b]) => Math.abs(a - x) < 70 && Math.abs(b - y) < 12)) y += upper ? 12 : -12;
    taken.push([x, y]);
    label(parent, x + (right ? -8 : 8), y, name, { "text-anchor": right ? "end" : "start",
      fill: layer.colour, class: "name" });
  });
}
