// The map: path, ellipses, sensors and their sight lines on the plane, north (or y) up, one scale.

function mapBounds(scene, all) {
  const xs = [[...scene.path[0]]], ys = [[...scene.path[1]]];
  const { xyz, covariance } = scene.ellipsoids;
  xyz[0].forEach((x, row) => {
    const xx = covariance[0][row], yy = covariance[3][row];
    if (xx === null) return;
    const dx = RADIUS_PLANE * scene.factor * Math.sqrt(xx), dy = RADIUS_PLANE * scene.factor * Math.sqrt(yy);
    xs.push([x - dx, x + dx]);
    ys.push([xyz[1][row] - dy, xyz[1][row] + dy]);
  });
  if (all) {
    for (const sensor of scene.sensors) { xs.push(sensor.xyz[0]); ys.push(sensor.xyz[1]); }
    if (scene.truth) { xs.push(scene.truth[0]); ys.push(scene.truth[1]); }
  }
  return [spanOf(xs), spanOf(ys)];
}

function drawMap(host, scene, all) {
  host.textContent = "";
  const width = Math.max(260, host.clientWidth), height = Math.round(Math.min(560, Math.max(300, width * 0.8)));
  const [[west, east], [south, north]] = mapBounds(scene, all);
  const size = Math.max(east - west, north - south, 1e-3);
  const scale = Math.min((width - 90) / Math.max(east - west, size * 0.05),
    (height - 90) / Math.max(north - south, size * 0.05));
  const centre = [(west + east) / 2, (south + north) / 2];
  const atX = (x) => width / 2 + (x - centre[0]) * scale;
  const atY = (y) => height / 2 - (y - centre[1]) * scale;
  const root = shape("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", class: "map",
    "aria-label": "map of the path and the sensors" }, host);
  const line = (points, attributes) => shape("path", { d: linePath(points[0], points[1], atX, atY),
    fill: "none", ...attributes }, root);
  if (scene.earth) drawGraticule(root, all ? scene.graticule : scene.near, { line, atX, atY, width, height });
  else drawGrid(root, { centre, scale, width, height, atX, atY });
  if (all) {
    for (const sensor of scene.sensors) {
      for (const sight of sensor.sights) line(sight, { stroke: sensor.colour, "stroke-opacity": 0.4, "stroke-width": 0.8 });
    }
  }
  drawEllipses(root, scene, { atX, atY, scale });
  if (scene.truth) drawTruth(root, scene, { line, atX, atY });
  line(scene.path, { stroke: PATH, "stroke-width": 2.4, "stroke-linejoin": "round" });
  if (!scene.static) drawEnds(root, scene, { atX, atY });
  const carried = drawSensors(root, scene, { atX, atY, line, width, height });
  const object = shape("g", { class: "object" }, root);
  drawScale(root, scale, width, height);
  label(root, width - 8, 16, scene.earth ? "north up" : `${scene.names[1]} up`, { "text-anchor": "end" });
  pictureLegend(host, scene, { sights: all, what: "ellipses" });
  return (row) => moveObject(object, carried, scene, row, { atX, atY, scale });
}

function drawGraticule(root, lines, { line, atX, atY, width, height }) {
  for (const { label: name, xyz } of lines) {
    line(xyz, { stroke: GRID, "stroke-width": 1 });
    const inside = (row) => {
      const x = atX(xyz[0][row]), y = atY(xyz[1][row]);
      return x > 2 && x < width - 40 && y > 14 && y < height - 24 ? [x, y] : null;
    };
    // At the western end of a parallel, at the southern end of a meridian.
    const row = xyz[0].findIndex((_, index) => inside(index));
    if (row < 0) continue;
    const [x, y] = inside(row);
    label(root, x + 3, y - 3, name, { fill: FAINT, class: "small" });
  }
}

function drawGrid(root, { centre, scale, width, height, atX, atY }) {
  const step = roundStep(width / scale, 6);
  const unit = step >= 1000 ? [1000, "km"] : [1, "m"];
  const half = [width / 2 / scale, height / 2 / scale];
  for (const x of multiples(centre[0] - half[0], centre[0] + half[0], step)) {
    shape("line", { x1: atX(x), x2: atX(x), y1: 0, y2: height, stroke: GRID }, root);
    if (atX(x) > 40 && atX(x) < width - 40) label(root, atX(x) + 3, height - 26, `${numberText(x / unit[0], step / unit[0])} ${unit[1]}`, { fill: FAINT, class: "small" });
  }
  for (const y of multiples(centre[1] - half[1], centre[1] + half[1], step)) {
    shape("line", { x1: 0, x2: width, y1: atY(y), y2: atY(y), stroke: GRID }, root);
    if (atY(y) > 20 && atY(y) < height - 40) label(root, 3, atY(y) - 3, `${numberText(y / unit[0], step / unit[0])} ${unit[1]}`, { fill: FAINT, class: "small" });
  }
}

function ellipseShape(parent, x, y, covariance, row, radius, { atX, atY, scale }, attributes) {
  const found = ellipseOf(covariance[0][row], covariance[1][row], covariance[3][row], radius);
  if (!found) return;
  shape("ellipse", { rx: found.major * scale, ry: found.minor * scale,
    transform: `translate(${atX(x).toFixed(2)} ${atY(y).toFixed(2)}) rotate(${(-found.turn * 180 / Math.PI).toFixed(2)})`,
    ...attributes }, parent);
}

function drawEllipses(root, scene, view) {
  const { xyz, covariance } = scene.ellipsoids;
  xyz[0].forEach((x, row) => ellipseShape(root, x, xyz[1][row], covariance, row, RADIUS_PLANE * scene.factor,
    view, { fill: BAND, "fill-opacity": 0.35, stroke: PATH, "stroke-width": 0.7 }));
}

function standsStill([xs, ys, zs]) {
  return xs.every((x, row) => x === xs[0] && ys[row] === ys[0] && zs[row] === zs[0]);
}

function drawTruth(root, scene, { line, atX, atY }) {
  const [xs, ys] = scene.truth;
  if (standsStill(scene.truth)) shape("path", { d: markerPath("x", atX(xs[0]), atY(ys[0]), 6), stroke: INK, "stroke-width": 1.6 }, root);
  else line(scene.truth, { stroke: INK, "stroke-dasharray": "5 3", "stroke-width": 1.3 });
}

function drawEnds(root, scene, { atX, atY }) {
  const last = scene.path[0].length - 1;
  shape("path", { d: markerPath("o", atX(scene.path[0][0]), atY(scene.path[1][0]), 4), fill: "white", stroke: PATH, "stroke-width": 1.6 }, root);
  shape("path", { d: markerPath("s", atX(scene.path[0][last]), atY(scene.path[1][last]), 4), fill: PATH, stroke: PATH }, root);
}

function drawSensors(root, scene, { atX, atY, line, width, height }) {
  const named = scene.sensors.length <= 12, carried = [], taken = [];
  for (const sensor of scene.sensors) {
    const moving = sensor.time.length > 1, last = sensor.time.length - 1;
    if (moving) line(sensor.xyz, { stroke: sensor.colour, "stroke-width": 1.2 });
    const [x, y] = [atX(sensor.xyz[0][last]), atY(sensor.xyz[1][last])];
    const group = shape("g", {}, root);
    tip(shape("path", { d: markerPath(sensor.marker, 0, 0, 5), fill: sensor.colour, stroke: "black", "stroke-width": 0.7 }, group), sensor.name);
    group.setAttribute("transform", `translate(${x} ${y})`);
    if (moving) carried.push([group, sensor]);
    if (!named || x < 0 || x > width || y < 0 || y > height) continue;
    let above = y - 8;
    while (taken.some(([a, b]) => Math.abs(a - x) < 80 && Math.abs(b - above) < 12)) above -= 12;
    taken.push([x, above]);
    const right = x > width - 110;
    label(group, right ? -6 : 6, above - y, sensor.name, { "text-anchor": right ? "end" : "start", class: "halo" });
  }
  return carried;
}

function drawScale(root, scale, width, height) {
  const metres = roundStep(width / 4 / scale, 1.6), long = metres * scale;
  shape("path", { d: `M10,${height - 14}v5h${long}v-5`, stroke: INK, fill: "none" }, root);
  label(root, 14 + long, height - 8, lengthText(metres), {});
}

function moveObject(object, carried, scene, row, view) {
  object.textContent = "";
  const { xyz, covariance, time } = scene.frames;
  const [x, y] = [xyz[0][row], xyz[1][row]];
  ellipseShape(object, x, y, covariance, row, RADIUS_PLANE * scene.factor, view,
    { fill: "#D55E00", "fill-opacity": 0.2, stroke: "#D55E00", "stroke-width": 1.2 });
  shape("path", { d: markerPath("o", view.atX(x), view.atY(y), 5.5), fill: "#D55E00", stroke: "white", "stroke-width": 1.5 }, object);
  object.setAttribute("data-x", x);
  object.setAttribute("data-y", y);
  for (const [group, sensor] of carried) {
    const [east, north] = placeAt(sensor, time[row]);
    group.setAttribute("transform", `translate(${view.atX(east)} ${view.atY(north)})`);
  }
}

function larger(scene) {
  return scene.factor > 1 ? `, drawn ${scene.factor} times larger` : "";
}

function pictureLegend(host, scene, { sights, what }) {
  const entries = scene.static ? [] : [
    { kind: "line", colour: PATH, width: 2.4, label: "path, from circle to square" }];
  entries.push({ kind: "points", marker: "o", colour: "#D55E00", label: scene.static ? "position" : "object" });
  entries.push({ kind: "band", colour: BAND, edge: PATH, opacity: 0.35, label: `95 % ${what}${larger(scene)}` });
  if (scene.truth) {
    entries.push(standsStill(scene.truth) ? { kind: "points", marker: "x", colour: INK, label: "truth" }
      : { kind: "line", colour: INK, dash: true, label: "truth" });
  }
  if (sights && scene.sensors.some((sensor) => sensor.sights.length)) {
    entries.push({ kind: "line", colour: FAINT, width: 0.8, label: "some bearings, as measured" });
  }
  if (scene.sensors.length > 12) {
    entries.push({ kind: "points", marker: "o", colour: FAINT, edge: "black", label: "sensors" });
  }
  legend(host, entries);
}
