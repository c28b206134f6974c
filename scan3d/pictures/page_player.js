// The player: one sample of one sweep at a time, with rod, clamp and reactions, and the reactions over the travel of the clamp.
// Lengths of what is drawn with the rod, in rod lengths: the longest arrow, its head, the clamp, the radius of the moment.
const drawn = {arrow: 0.35, head: 0.05, clamp: 0.07, moment: 0.09};
// Rods along a sweep, the longest arc of a moment in radians, and the diameter in pixels of the contacts of the present sweep.
const trailRods = 9, longestArc = 1.6 * Math.PI, traceSize = 6;
const player = gl && data.player || null;
const now = byId("now"), curves = byId("curves");

function preparePlayer() {
  for (const name of ["position", "reactions", "turns"]) player[name] = new Float32Array(bytes(player[name]));
  if (player.bending) player.bending = new Float32Array(bytes(player.bending));
  for (const name of ["turned", "contact"]) player[name] = new Uint32Array(bytes(player[name]));
  const n = player.position.length / 3;
  player.starts.push(n);
  player.width = player.reactions.length / n;
  player.contactOf = new Int32Array(n).fill(-1);
  player.contact.forEach((k, contact) => { player.contactOf[k] = contact; });
  Object.assign(player, {on: false, trail: false, preview: -1, time: 0, stale: true, lines: [], trace: null});
  byId("sweep").max = player.numbers.length - 1;
  goTo(player.shown, Math.floor((player.starts[player.shown + 1] - player.starts[player.shown]) / 2));
  dock.hidden = false;
}

const shownSample = () => player.preview >= 0 ? player.preview : player.sample;

function sweepOf(k) {
  let low = 0, high = player.numbers.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (player.starts[middle] <= k) low = middle; else high = middle - 1;
  }
  return low;
}

function goTo(sweep, sample) {  // to a sample of a sweep, both counted from 0
  player.sweep = Math.min(player.numbers.length - 1, Math.max(0, sweep));
  const first = player.starts[player.sweep], count = player.starts[player.sweep + 1] - first;
  player.sample = first + Math.min(count - 1, Math.max(0, sample));
  const slider = byId("sample");
  slider.max = count - 1; slider.value = player.sample - first; byId("sweep").value = player.sweep;
  byId("sweep").setAttribute("aria-valuetext", `sweep ${player.numbers[player.sweep]}`);
  slider.setAttribute("aria-valuetext", `sample ${player.sample - first + 1} of ${count}`);
  player.preview = -1; player.stale = true;
}

const goToSample = k => { const sweep = sweepOf(k); goTo(sweep, k - player.starts[sweep]); };

function preview(k) {  // show a sample as long as the pointer is at it, -1 for none
  if (!player || player.preview === k) return;
  player.preview = k; player.stale = true; redraw();
}

function switchPlayer(on) {
  if (player.on === on) return;
  player.on = on; player.stale = true; player.box.checked = on;
  byId("charts").setAttribute("aria-pressed", on); curves.hidden = !on;
  if (on && !player.fitted && Object.keys(start).every(name => eye[name] === start[name])) lookAtSweep();
  redraw();
}

// From a sweep toward the viewer, along the clamp's axes: rods hide little of the body and do not hide each other.
const toViewer = [0.45, -0.6, 0.7];

function lookAtSweep() {  // once, unless the view was changed before: from its side, with the clamps of all sweeps in view
  const axes = clampAxes(player.sample), [x, y, z] = [0, 1, 2].map(i => dot(toViewer, axes.map(axis => axis[i])));
  eye.azimuth = Math.atan2(x, -y); eye.elevation = Math.atan2(z, Math.hypot(x, y)); player.fitted = true;
  const view = measures(), m = turned(), L = drawn.clamp * player.length;
  let wide = data.radius, high = data.radius;
  for (let k = 0; k < player.position.length; k += 3) {
    const [u, v] = onScreen(clampAt(k / 3), m, view);
    wide = Math.max(wide, Math.abs(u - view.x) / view.unit + L); high = Math.max(high, Math.abs(v - view.y) / view.unit + L);
  }
  eye.zoom = data.radius * Math.min(view.wide / wide, view.high / high) / Math.min(view.wide, view.high);
}

function travelOf(sweep) {  // (samples,) the way of the clamp against its x axis since the first sample
  const first = player.starts[sweep], count = player.starts[sweep + 1] - first;
  const origin = clampAt(first), x = clampAxes(first)[0];
  return Float64Array.from({length: count}, (_, k) => -dot(plus(clampAt(first + k), origin, -1), x));
}

function strip(lines, color, width) {
  const starts = [0];
  for (const line of lines) starts.push(starts[starts.length - 1] + line.length);
  return {points: new Float32Array(lines.flat(2)), starts, color, width};
}

function arrow(from, vector, normal) {  // shaft and head, in the plane with this normal
  const to = plus(from, vector), along = unitVector(vector), across = cross(normal, along), head = drawn.head * player.length;
  const barb = side => plus(plus(to, along, -head), across, side * 0.5 * head);
  return Math.hypot(...vector) > 0 ? [[from, to], [barb(1), to, barb(-1)]] : [];
}

function arc(rod, turn) {  // an arrow around the moment's axis, beginning at the rod, as long as the moment is large
  const L = player.length, n = unitVector(rod.moment), u = unitVector(plus(rod.y, n, -dot(rod.y, n))), v = cross(n, u);
  const at = t => plus(plus(rod.base, u, drawn.moment * L * Math.cos(t)), v, drawn.moment * L * Math.sin(t));
  const line = Array.from({length: 33}, (_, k) => at(turn * k / 32)), end = plus(at(turn), at(turn - 0.05), -1);
  return [line, ...arrow(plus(at(turn), unitVector(end), -1e-3 * L), unitVector(end).map(c => 1e-3 * L * c), n).slice(1)];
}

function buildRod() {  // what is drawn of the shown sample, and the text and curves that belong to it
  player.stale = false;
  const k = shownSample(), sweep = sweepOf(k), first = player.starts[sweep], last = player.starts[sweep + 1] - 1;
  const {rod: blue, force: purple, selected, ink} = player.colors, rod = rodAt(k), L = player.length;
  const n = cross(rod.across, rod.y);
  let force = 0, moment = 0;
  for (let i = first; i <= last; i++) {
    force = Math.max(force, sizeAt(i, 0)); moment = Math.max(moment, sizeAt(i, 1));
  }
  const scaled = rod.force.map(f => f * drawn.arrow * L / (force || 1)), lines = [];
  lines.push(strip([[clampAt(first), clampAt(last)]], "#8a8a8a", 1.2));
  if (player.trail) {
    const count = Math.min(trailRods, last - first + 1);
    const chosen = Array.from({length: count}, (_, i) => Math.round(first + (last - first) * i / Math.max(1, count - 1)));
    lines.push(strip(chosen.map(i => rodAt(i).points), "#8fb8d8", 1.5));
  }
  lines.push(strip([rod.points], blue, 3.5));
  lines.push(strip([[rod.base, plus(rod.base, rod.y, -drawn.clamp * L)]], ink, 11));
  if (rod.touches) {
    lines.push(strip([...arrow(rod.base, scaled, n), ...arrow(rod.points[rod.contact], scaled.map(f => -f), n),
      ...arc(rod, longestArc * Math.hypot(...rod.moment) / (moment || 1))], purple, 2.5));
  }
  player.lines.forEach(line => gl.deleteBuffer(line.buffer));
  player.lines = lines.map(line => ({...line, buffer: buffer(gl.ARRAY_BUFFER, line.points)}));
  const all = data.layers.find(layer => layer.kind === "points"), trace = [];
  for (let i = first; i <= k; i++) {
    const contact = player.contactOf[i];
    if (contact >= 0) trace.push(...all.points.subarray(3 * contact, 3 * contact + 3));
  }
  const points = new Float32Array(trace), old = player.trace && player.trace.buffer;
  player.trace = {points, color: selected, buffer: buffer(gl.ARRAY_BUFFER, points, old || gl.createBuffer())};
  describe(k, sweep, rod);
  if (player.on) drawCurves(k, sweep);
}

function sizeAt(k, part) {  // the size of the force (part 0) or the moment (part 1) of a sample
  const from = player.width * k, middle = player.width === 6 ? 3 : 2;
  return Math.hypot(...player.reactions.subarray(part ? from + middle : from, part ? from + player.width : from + middle));
}

const names = () => player.labels.flatMap(chart => chart.names.map(name => [name, chart.title.split(" in ")[1]]));

function describe(k, sweep, rod) {
  const count = player.starts[sweep + 1] - player.starts[sweep], place = k - player.starts[sweep];
  const contact = player.contactOf[k];
  const layer = data.layers.find(layer => layer.kind === "points"), slices = layer.columns.slice;
  const slice = slices && contact >= 0 ? `, slice ${slices[contact]}` : "";
  const kind = layer.colors.find(scale => scale.kinds);
  const what = contact < 0 ? "no contact" : kind ? kind.kinds[kind.values[contact]][0] + " contact" : "contact";
  const value = ([name, unit], i) => `${name} = ${number(rod.values[i])} ${unit}`.replaceAll(" ", "\u00a0");
  const values = names().map(value).join(", ");
  now.textContent = `sweep ${player.numbers[sweep]} (no. ${sweep + 1} of ${player.numbers.length} with contact)${slice}, `
    + `sample ${place + 1} of ${count}: ${what}${rod.touches ? ` at ${number(rod.s1)} of the rod's length` : ""}; ${values}`;
  curves.setAttribute("aria-label", `reactions over the travel of the clamp; ${values}`);
}

function drawRod(view, ratio) {
  if (player.stale) buildRod();
  if (!player.on) return;
  for (const line of player.lines) drawLines(line, view, ratio, false);
  if (player.trace.points.length) drawPoints(player.trace, {size: traceSize, alpha: 1}, view, ratio, false, 0.006);
}

// --- the curves ---

function ticks(low, high, most) {  // round numbers from low to high
  const length = high - low, power = 10 ** Math.floor(Math.log10(length / most));
  const step = power * [1, 2, 5, 10].find(k => length / (k * power) <= most), first = Math.ceil(low / step - 1e-9);
  return Array.from({length: Math.floor(high / step + 1e-9) - first + 1}, (_, k) => (first + k) * step);
}

function curveFrames() {  // places of the charts in CSS pixels
  const w = curves.clientWidth, h = curves.clientHeight, size = 0.82 * fontSize();
  const count = player.labels.length, left = 3.4 * size, each = w / count;
  return player.labels.map((chart, i) => (
    {chart, size, x: i * each + left, w: each - left - size, y: 1.7 * size, h: h - 4.4 * size}));
}

function drawCurves(k, sweep) {
  const ratio = window.devicePixelRatio || 1, context = curves.getContext("2d");
  curves.width = Math.round(curves.clientWidth * ratio); curves.height = Math.round(curves.clientHeight * ratio);
  context.scale(ratio, ratio);
  const first = player.starts[sweep], travel = travelOf(sweep);
  let column = 0;
  for (const frame of curveFrames()) {
    const value = (i, j) => player.reactions[player.width * (first + j) + column + i];
    const rows = frame.chart.names.map((_, i) => travel.map((_, j) => value(i, j)));
    column += rows.length;
    drawChart(context, frame, travel, rows, k - first);
  }
}

function drawChart(context, {chart, size, x, y, w, h}, travel, rows, shown) {
  const near = Math.min(...travel), far = Math.max(...travel), width = far - near || 1;
  const low = Math.min(0, ...rows.map(row => Math.min(...row))), top = Math.max(0, ...rows.map(row => Math.max(...row)));
  const high = top > low ? top : low + 1;
  const px = t => x + w * (t - near) / width, py = v => y + h * (high - v) / (high - low);
  const line = (...points) => {
    context.beginPath(); points.forEach(([u, v], i) => { i ? context.lineTo(u, v) : context.moveTo(u, v); }); context.stroke();
  };
  context.font = `${size}px system-ui, sans-serif`; context.lineWidth = 1; context.strokeStyle = "#d0d0d0";
  context.fillStyle = "#222"; context.textBaseline = "middle"; context.textAlign = "right";
  for (const t of ticks(low, high, h > 7 * size ? 4 : 3)) {
    context.fillText(number(t), x - 4, py(t)); line([x, py(t)], [x + w, py(t)]);
  }
  context.textAlign = "center"; context.textBaseline = "top";
  for (const t of ticks(near, near + width, Math.max(2, w / (5 * size)))) context.fillText(number(t), px(t), y + h + 4);
  const axis = "travel of the clamp in " + data.unit, short = "travel in " + data.unit;
  context.fillText(context.measureText(axis).width < w ? axis : short, x + w / 2, y + h + 4 + 1.3 * size);
  context.textAlign = "left"; context.textBaseline = "alphabetic";
  const titled = Math.min(x, x + w - context.measureText(chart.title).width);
  context.fillText(chart.title, titled, y - 0.6 * size);
  let legendAt = titled + context.measureText(chart.title + "  ").width;
  context.strokeStyle = "#222"; line([px(travel[shown]), y], [px(travel[shown]), y + h]);
  rows.forEach((row, i) => {
    context.strokeStyle = context.fillStyle = player.colors.curves[rows.length > 1 ? i : 0]; context.lineWidth = 1.8;
    line(...Array.from(row, (value, j) => [px(travel[j]), py(value)]));
    context.beginPath(); context.arc(px(travel[shown]), py(row[shown]), 4, 0, 2 * Math.PI); context.fill();
    if (rows.length === 1) return;
    context.fillText(chart.names[i], legendAt, y - 0.6 * size);
    legendAt += context.measureText(chart.names[i] + "  ").width;
  });
}

function sampleAtCurve(clientX) {  // the sample of the present sweep whose travel is nearest to a place in a chart
  const x = clientX - curves.getBoundingClientRect().left, frames = curveFrames(), travel = travelOf(player.sweep);
  const chart = frames.reduce((a, b) => Math.abs(x - a.x - a.w / 2) <= Math.abs(x - b.x - b.w / 2) ? a : b);
  const near = Math.min(...travel), far = Math.max(...travel), at = near + (x - chart.x) / chart.w * (far - near);
  const nearest = travel.reduce((best, t, i) => Math.abs(t - at) < Math.abs(travel[best] - at) ? i : best, 0);
  return player.starts[player.sweep] + nearest;
}

// --- playing ---

function play(on = !player.playing) {
  player.playing = on; now.setAttribute("aria-live", on ? "off" : "polite");
  byId("play").textContent = on ? "❚❚" : "▶"; byId("play").setAttribute("aria-label", on ? "pause" : "play");
  if (!on) return;
  switchPlayer(true);
  const atEnd = player.sample === player.starts[player.sweep + 1] - 1;
  if (atEnd) goTo(player.sweep + (byId("through").checked && player.sweep < player.numbers.length - 1), 0);
  player.time = performance.now(); player.share = 0;
  requestAnimationFrame(advance);
}

function advance(time) {
  if (!player.playing) return;
  const count = player.starts[player.sweep + 1] - player.starts[player.sweep];
  player.share += Math.max(0, time - player.time) / 1000 / byId("speed").value * count; player.time = time;
  const whole = Math.floor(player.share);
  player.share -= whole;
  const next = player.sample - player.starts[player.sweep] + whole;
  if (whole && next < count) goTo(player.sweep, next);
  else if (whole && byId("through").checked && player.sweep < player.numbers.length - 1) goTo(player.sweep + 1, 0);
  else if (whole) { goTo(player.sweep, count - 1); play(false); }
  redraw(); requestAnimationFrame(advance);
}
