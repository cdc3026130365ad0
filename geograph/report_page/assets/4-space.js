// The view in space, on a canvas: parallel projection, one scale on all axes, turned by dragging.

function spaceView(host, scene, all, look) {
  host.textContent = "";
  const canvas = element("canvas", "space", "", host);
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "path, ellipsoids and sensors in space; drag or use the arrow keys to turn");
  const width = Math.max(260, host.clientWidth), height = Math.round(Math.min(560, Math.max(300, width * 0.8)));
  const dense = Math.min(3, Math.max(2, window.devicePixelRatio || 1));
  canvas.width = width * dense;
  canvas.height = height * dense;
  canvas.style.aspectRatio = `${width} / ${height}`;
  const pen = canvas.getContext("2d");
  let row = 0;
  const draw = () => {
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    drawSpace(pen, scene, all, look, row, width, height);
  };
  steer(canvas, look, draw);
  pictureLegend(host, scene, { sights: false, what: "ellipsoids" });
  return (index) => { row = index; draw(); };
}

function steer(canvas, look, draw) {
  let from = null;
  const turn = (dx, dy) => {
    look.yaw -= dx;
    look.pitch = Math.min(Math.PI / 2, Math.max(0, look.pitch + dy));
    draw();
  };
  canvas.addEventListener("pointerdown", (event) => {
    from = [event.clientX, event.clientY];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!from) return;
    turn((event.clientX - from[0]) * 0.01, (event.clientY - from[1]) * 0.01);
    from = [event.clientX, event.clientY];
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { from = null; });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
    if (!step) return;
    event.preventDefault();
    turn(...step);
  });
}

function columnsOf(points) {
  return points[0].map((_, row) => [points[0][row], points[1][row], points[2][row]]);
}

/** The box in space around what is shown: its centre, its level radius and its half height. */
function spaceBounds(scene, all) {
  const points = columnsOf(scene.path);
  const { xyz, covariance } = scene.ellipsoids;
  xyz[0].forEach((x, row) => {
    if (covariance[0][row] === null) return;
    const reach = [0, 3, 5].map((entry) => RADIUS_SPACE * scene.factor * Math.sqrt(Math.max(covariance[entry][row], 0)));
    for (const sign of [-1, 1]) points.push([x + sign * reach[0], xyz[1][row] + sign * reach[1], xyz[2][row] + sign * reach[2]]);
  });
  if (all) {
    for (const sensor of scene.sensors) points.push(...columnsOf(sensor.xyz));
    if (!scene.static) points.push(...columnsOf(scene.ground));
  }
  const spans = [0, 1, 2].map((axis) => spanOf([points.map((point) => point[axis])]));
  const centre = spans.map(([low, high]) => (low + high) / 2);
  const flat = Math.max(...points.map(([x, y]) => Math.hypot(x - centre[0], y - centre[1])), 1e-3);
  const tall = Math.max((spans[2][1] - spans[2][0]) / 2, 1e-3 * flat);
  return { centre, flat, tall, floor: spans[2][0] };
}

function drawSpace(pen, scene, all, look, row, width, height) {
  const { centre, flat, tall, floor } = spaceBounds(scene, all);
  const [sa, ca, sp, cp] = [Math.sin(look.yaw), Math.cos(look.yaw), Math.sin(look.pitch), Math.cos(look.pitch)];
  const scale = look.zoom * Math.min((width / 2 - 40) / flat, (height / 2 - 36) / (flat * sp + tall * cp));
  const axes = [[ca, sa, 0], [-sa * sp, ca * sp, cp]];
  const at = ([x, y, z]) => {
    const [dx, dy, dz] = [x - centre[0], y - centre[1], z - centre[2]];
    return [width / 2 + scale * (axes[0][0] * dx + axes[0][1] * dy),
      height / 2 - scale * (axes[1][0] * dx + axes[1][1] * dy + axes[1][2] * dz)];
  };
  const view = { at, axes, scale, width, height };
  pen.clearRect(0, 0, width, height);
  pen.font = "12px system-ui, sans-serif";
  const onEarth = scene.earth && all;
  if (onEarth) for (const { xyz } of scene.graticule) stroke(pen, view, columnsOf(xyz), GRID, 1);
  else drawFloor(pen, view, centre, flat, floor);
  drawShadow(pen, scene, view, onEarth ? null : floor);
  const { xyz, covariance } = scene.ellipsoids;
  xyz[0].forEach((_, index) => drawEllipsoid(pen, view, xyz, covariance, index, scene.factor, BAND, PATH, 0.3));
  if (scene.truth) stroke(pen, view, columnsOf(scene.truth), INK, 1.3, [5, 3]);
  stroke(pen, view, columnsOf(scene.path), PATH, 2.4);
  if (all) drawSpaceSensors(pen, scene, view, row);
  drawMoving(pen, scene, view, row);
  drawTriad(pen, scene, axes, height);
  drawBar(pen, scale, width, height);
}

function stroke(pen, { at }, points, colour, width, dash) {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.setLineDash(dash || []);
  pen.beginPath();
  points.forEach((point, index) => {
    const [x, y] = at(point);
    if (index) pen.lineTo(x, y); else pen.moveTo(x, y);
  });
  pen.stroke();
  pen.setLineDash([]);
}

function drawFloor(pen, view, centre, flat, floor) {
  const step = roundStep(2 * flat, 8), reach = Math.ceil(flat / step) * step;
  const middle = [Math.round(centre[0] / step) * step, Math.round(centre[1] / step) * step];
  for (let offset = -reach; offset <= reach * 1.0001; offset += step) {
    stroke(pen, view, [[middle[0] + offset, middle[1] - reach, floor], [middle[0] + offset, middle[1] + reach, floor]], GRID, 1);
    stroke(pen, view, [[middle[0] - reach, middle[1] + offset, floor], [middle[0] + reach, middle[1] + offset, floor]], GRID, 1);
  }
}

function drawShadow(pen, scene, view, floor) {
  if (scene.static) return;
  const path = columnsOf(scene.path);
  let below = columnsOf(scene.ground);
  const count = below.length, every = (index) => Math.round(index * (path.length - 1) / Math.max(count - 1, 1));
  if (floor !== null) below = below.map((_, index) => [path[every(index)][0], path[every(index)][1], floor]);
  stroke(pen, view, below, "#9a9a9a", 1.4);
  for (let part = 0; part <= 8; part++) {
    const index = Math.round(part * (count - 1) / 8);
    stroke(pen, view, [path[every(index)], below[index]], "#c9c9c9", 1);
  }
}

function drawEllipsoid(pen, view, xyz, covariance, row, factor, fill, edge, opacity) {
  const c = covariance.map((entry) => entry[row]);
  if (c.includes(null)) return false;
  const full = [[c[0], c[1], c[2]], [c[1], c[3], c[4]], [c[2], c[4], c[5]]];
  const product = (a, b) => a.reduce((sum, value, i) => sum + value * (full[i][0] * b[0] + full[i][1] * b[1] + full[i][2] * b[2]), 0);
  const [right, up] = view.axes;
  const found = ellipseOf(product(right, right), product(right, up), product(up, up), RADIUS_SPACE * factor * view.scale);
  const [x, y] = view.at([xyz[0][row], xyz[1][row], xyz[2][row]]);
  pen.beginPath();
  pen.ellipse(x, y, found.major, found.minor, -found.turn, 0, 2 * Math.PI);
  pen.globalAlpha = opacity;
  pen.fillStyle = fill;
  pen.fill();
  pen.globalAlpha = 1;
  pen.strokeStyle = edge;
  pen.lineWidth = 0.8;
  pen.stroke();
  return true;
}

function drawSpaceSensors(pen, scene, view, row) {
  const named = scene.sensors.length <= 12, time = scene.frames.time[row];
  for (const sensor of scene.sensors) {
    if (sensor.time.length > 1) stroke(pen, view, columnsOf(sensor.xyz), sensor.colour, 1.2);
    const [x, y] = view.at(placeAt(sensor, time));
    const outline = new Path2D(markerPath(sensor.marker, x, y, 5));
    pen.fillStyle = sensor.colour;
    pen.strokeStyle = "black";
    pen.lineWidth = 0.7;
    pen.fill(outline);
    pen.stroke(outline);
    if (!named || x < 0 || x > view.width) continue;
    haloText(pen, sensor.name, x > view.width - 110 ? x - 7 : x + 7, y - 6, x > view.width - 110 ? "right" : "left");
  }
}

function haloText(pen, text, x, y, align) {
  pen.textAlign = align;
  pen.strokeStyle = "white";
  pen.lineWidth = 3;
  pen.strokeText(text, x, y);
  pen.fillStyle = INK;
  pen.fillText(text, x, y);
}

function drawMoving(pen, scene, view, row) {
  const { xyz, covariance } = scene.frames;
  const drawn = drawEllipsoid(pen, view, xyz, covariance, row, scene.factor, "#D55E00", "#D55E00", 0.18);
  if (drawn) drawHoops(pen, view, xyz, covariance, row, scene.factor);
  const [x, y] = view.at([xyz[0][row], xyz[1][row], xyz[2][row]]);
  const outline = new Path2D(markerPath("o", x, y, 5.5));
  pen.fillStyle = "#D55E00";
  pen.fill(outline);
  pen.strokeStyle = "white";
  pen.lineWidth = 1.5;
  pen.stroke(outline);
}

/** Three closed lines on the ellipsoid, by the Cholesky factor of its covariance. */
function drawHoops(pen, view, xyz, covariance, row, factor) {
  const [xx, xy, xz, yy, yz, zz] = covariance.map((entry) => entry[row]);
  const a = Math.sqrt(Math.max(xx, 0)), b = a ? xy / a : 0, c = a ? xz / a : 0;
  const d = Math.sqrt(Math.max(yy - b * b, 0)), e = d ? (yz - b * c) / d : 0;
  const f = Math.sqrt(Math.max(zz - c * c - e * e, 0)), size = RADIUS_SPACE * factor;
  for (const [first, second] of [[0, 1], [0, 2], [1, 2]]) {
    const points = [];
    for (let step = 0; step <= 48; step++) {
      const u = [0, 0, 0];
      u[first] = size * Math.cos(step * Math.PI / 24);
      u[second] = size * Math.sin(step * Math.PI / 24);
      points.push([xyz[0][row] + a * u[0], xyz[1][row] + b * u[0] + d * u[1], xyz[2][row] + c * u[0] + e * u[1] + f * u[2]]);
    }
    stroke(pen, view, points, "rgba(213, 94, 0, 0.55)", 0.8);
  }
}

function drawTriad(pen, scene, axes, height) {
  const [x, y] = [64, height - 44];
  scene.names.forEach((name, axis) => {
    const [dx, dy] = [28 * axes[0][axis], -28 * axes[1][axis]];
    pen.strokeStyle = FAINT;
    pen.lineWidth = 1.4;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(x + dx, y + dy);
    pen.stroke();
    if (Math.hypot(dx, dy) > 6) haloText(pen, name, x + 1.25 * dx, y + 1.25 * dy + 4, dx < -3 ? "right" : dx > 3 ? "left" : "center");
  });
}

function drawBar(pen, scale, width, height) {
  const metres = roundStep(width / 4 / scale, 1.6), long = metres * scale, right = width - 12;
  pen.strokeStyle = INK;
  pen.lineWidth = 1;
  pen.beginPath();
  pen.moveTo(right - long, height - 14);
  pen.lineTo(right - long, height - 9);
  pen.lineTo(right, height - 9);
  pen.lineTo(right, height - 14);
  pen.stroke();
  haloText(pen, lengthText(metres), right, height - 18, "right");
}
