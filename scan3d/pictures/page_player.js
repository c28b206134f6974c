// The player: one sample of one sweep at a time, with rod, clamp and reactions, and the reactions over the travel of the clamp.
const player = gl && data.player || null;
const now = byId("now"), curves = byId("curves");
// Steps of the integration along the whole rod; its error, of the fourth order, is below a pixel by far.
const rodSteps = 64;

function preparePlayer() {
  const n = player.position.length / 3;
  player.ends = [...player.starts.slice(1), n];
  player.width = player.reactions.length / n;
  player.contactOf = new Int32Array(n).fill(-1);
  player.contact.forEach((k, contact) => { player.contactOf[k] = contact; });
  player.moves = contacts.columns.slice?.some(k => k < 0) ? " sweeps and probings" : "";
  player.names = player.labels.flatMap(({title, names}) => names.map(name => [name, title.split(" in ")[1]]));
  Object.assign(player, {on: false, playing: false, time: 0, stale: true, lines: [], trace: null});
  byId("sweep").max = player.numbers.length - 1;
  goTo(player.shown, Math.floor((player.ends[player.shown] - player.starts[player.shown]) / 2));
  dock.hidden = false;
}

const sweepOf = k => player.starts.findLastIndex(start => start <= k);

function goTo(sweep, sample) {  // to a sample of a sweep, both counted from 0
  player.sweep = Math.min(player.numbers.length - 1, Math.max(0, sweep));
  const first = player.starts[player.sweep], count = player.ends[player.sweep] - first;
  player.sample = first + Math.min(count - 1, Math.max(0, sample));
  const slider = byId("sample");
  slider.max = count - 1; slider.value = player.sample - first; byId("sweep").value = player.sweep;
  byId("sweep").setAttribute("aria-valuetext", `sweep ${player.numbers[player.sweep]}`);
  slider.setAttribute("aria-valuetext", `sample ${player.sample - first + 1} of ${count}`);
  player.stale = true;
  redraw();
}

const goToSample = k => goTo(sweepOf(k), k - player.starts[sweepOf(k)]);

function switchPlayer(on) {
  if (player.on === on) return;
  const fitted = untouched();
  player.on = on; player.stale = true; player.box.checked = on;
  if (!on) showCurves(false);
  if (fitted) reset();
  redraw();
}

function showCurves(on) {  // and the rod that they belong to
  byId("charts").setAttribute("aria-pressed", on); curves.hidden = !on; player.stale = true;
  if (on) switchPlayer(true);
  redraw();
}

function lookAtSweep() {  // from its side, with the body and the clamps of this sweep in view
  const [x, y, z] = player.toward, range = [3 * player.starts[player.sweep], 3 * player.ends[player.sweep]];
  eye.azimuth = Math.atan2(x, -y); eye.elevation = Math.atan2(z, Math.hypot(x, y));
  const view = measures(), clamp = 0.07 * player.length * view.unit, [low, high] = [[Infinity, Infinity], [-Infinity, -Infinity]];
  const include = (points, margin) => onScreen(points).forEach((value, k) => {
    if (k % 3 < 2) { low[k % 3] = Math.min(low[k % 3], value - margin); high[k % 3] = Math.max(high[k % 3], value + margin); }
  });
  include(data.layers[0].points, 0); include(player.position.subarray(...range), clamp);
  include(rodAt(player.sample).points.flat(), 0);
  const zoom = 0.94 * Math.min(view.wide / (high[0] - low[0]), view.high / (high[1] - low[1]));
  eye.zoom *= zoom; eye.x = zoom * (view.x - (low[0] + high[0]) / 2); eye.y = zoom * ((low[1] + high[1]) / 2 - view.y);
}

// --- the rod of a sample ---

// Rods are marched in rod lengths, in the clamp's frame; a state is the place r, the tangent t, the axis d across it that turns
// with the rod, and the moment m of the rest on what is before it.
function turnedBy(v, turn) {  // by an angle about an axis
  const angle = Math.hypot(...turn), axis = unitVector(turn);
  return plus(plus(v.map(c => c * Math.cos(angle)), cross(axis, v), Math.sin(angle)), axis, dot(axis, v) * (1 - Math.cos(angle)));
}

function tabled(table, s) {  // a value at an arc length, from those at the ends of equal parts of the rod
  const at = Math.min(1, Math.max(0, s)) * (table.length - 1), k = Math.min(Math.floor(at), table.length - 2);
  return table[k] + (at - k) * (table[k + 1] - table[k]);
}

// r' = t, t' = u × t, d' = u × d, m' = n × t, with the curvature u by moment, stiffness and shape at rest, and the force n.
function rates(s, [, t, d, m], force, gravity) {
  const {diameters, weights, curvature, torsion} = player.rod, stiffness = tabled(diameters, s) ** 4, twist = dot(m, t);
  const bend = plus(m, t, (1 / torsion - 1) * twist).map(c => c / stiffness);
  const u = plus(plus(plus(bend, d, curvature[0]), cross(t, d), curvature[1]), t, curvature[2]);
  return [t, cross(u, t), cross(u, d), cross(gravity ? plus(force, gravity, tabled(weights, s)) : force, t)];
}

function marchStep(state, s, h, ...forces) {  // of the Runge-Kutta method of order 4
  const move = (k, h) => state.map((v, i) => plus(v, k[i], h));
  const a = rates(s, state, ...forces), b = rates(s + h / 2, move(a, h / 2), ...forces);
  const c = rates(s + h / 2, move(b, h / 2), ...forces), d = rates(s + h, move(c, h), ...forces);
  return state.map((v, i) => plus(plus(plus(plus(v, a[i], h / 6), b[i], h / 3), c[i], h / 3), d[i], h / 6));
}

function march(state, s, ...forces) {  // the states from an arc length to the tip
  const states = [state], count = Math.max(1, Math.ceil((1 - s) * rodSteps)), h = (1 - s) / count;
  for (let k = 0; k < count; k++) states.push(marchStep(states[k], s + k * h, h, ...forces));
  return states;
}

// Under the force of the contact up to the place that is nearest to it, or to the tip without one, and free from there.
function elasticLine(force, moment, gravity, contact, atTip) {
  const turn = moment.map(c => player.rod.compliance * c);
  let states = march([[0, 0, 0], turnedBy([0, 1, 0], turn), turnedBy([0, 0, 1], turn), moment], 0, force, gravity), s = 1;
  if (contact && !atTip) {
    const away = states.map(([r]) => Math.hypot(...minus(r, contact))), nearest = away.indexOf(Math.min(...away));
    let touching = states[nearest], h = 0;
    for (let i = 0; i < 4; i++) {
      h = Math.min(h - dot(minus(touching[0], contact), touching[1]), 1 - nearest / rodSteps);
      touching = marchStep(states[nearest], nearest / rodSteps, h, force, gravity);
    }
    s = nearest / rodSteps + h;
    states = [...states.slice(0, h < 0 ? nearest : nearest + 1), touching];
  }
  const free = march(states[states.length - 1], s, [0, 0, 0], gravity);
  return {points: [...states, ...free.slice(1)].map(([r]) => r), contact: states.length - 1, s1: s};
}

function clampAxes(k) {  // x, y and z of the clamp at a sample, in the world
  const turn = 9 * player.turned.findLastIndex(from => from <= k);  // the clamp keeps its orientation until the next one
  return [0, 3, 6].map(axis => [...player.turns.subarray(turn + axis, turn + axis + 3)]);
}

function kindOf(contact) {
  const kind = contacts.colors.find(scale => scale.kinds);
  return kind && contact >= 0 ? kind.kinds[kind.values[contact]][0] : null;
}

const clampAt = k => [...player.position.subarray(3 * k, 3 * k + 3)];

// The rod of a sample in the world: points from the clamp to the tip, of which number `contact` touches; reactions as vectors.
function rodAt(k) {
  const [x, y, z] = clampAxes(k), base = clampAt(k), L = player.length, v = player.reactions.subarray(player.width * k);
  const [f, m] = player.width === 6 ? [v.subarray(0, 3), v.subarray(3, 6)] : [[v[0], v[1], 0], [0, 0, v[2]]];
  const contact = player.contactOf[k], touches = contact >= 0;
  const world = v => plus(plus(x.map(c => v[0] * c), y, v[1]), z, v[2]), local = v => [x, y, z].map(axis => dot(axis, v));
  const place = touches && local(minus(contactPoint(contact), base)).map(c => c / L), held = player.held?.subarray(6 * k, 6 * k + 6);
  const [force, moment] = held ? [[...held.subarray(0, 3)], [...held.subarray(3)]]
    : [f, m].map((vector, i) => Array.from(vector, c => touches ? -c / player.rod.units[i] : 0));
  const line = elasticLine(force, moment, player.rod.gravity && local(player.rod.gravity), place,
    kindOf(contact) === "tip");
  return {base, x, y, z, force: world(f), moment: world(m), contact: line.contact, s1: line.s1, touches,
    points: line.points.map(point => plus(base, world(point), L))};
}

function strip(lines, color, width) {
  const starts = [0];
  for (const line of lines) starts.push(starts[starts.length - 1] + line.length);
  const points = new Float32Array(lines.flat(2));
  return {points, starts, color, width, buffer: buffer(gl.ARRAY_BUFFER, points)};
}

function arrow(from, vector, normal) {  // shaft and head, in the plane with this normal
  const to = plus(from, vector), along = unitVector(vector), across = cross(normal, along), head = 0.05 * player.length;
  const barb = side => plus(plus(to, along, -head), across, side * 0.5 * head);
  return Math.hypot(...vector) > 0 ? [[from, to], [barb(1), to, barb(-1)]] : [];
}

function arc(rod, turn) {  // an arrow around the moment's axis, beginning at the rod, as long as the moment is large
  const L = player.length, n = unitVector(rod.moment), u = unitVector(plus(rod.y, n, -dot(rod.y, n))), v = cross(n, u);
  const at = t => plus(plus(rod.base, u, 0.09 * L * Math.cos(t)), v, 0.09 * L * Math.sin(t));
  const line = Array.from({length: 33}, (_, k) => at(turn * k / 32)), end = unitVector(minus(at(turn), at(turn - 0.05)));
  return [line, ...arrow(plus(at(turn), end, -1e-3 * L), end.map(c => 1e-3 * L * c), n).slice(1)];
}

function buildRod() {  // what is drawn of the shown sample, and the text and curves that belong to it
  player.stale = false;
  const k = player.sample, sweep = sweepOf(k), first = player.starts[sweep], last = player.ends[sweep] - 1, L = player.length;
  const {rod: blue, force: purple, selected} = player.colors, ink = paperOrInk("ink"), rod = rodAt(k), normal = unitVector(rod.moment);
  const trace = [...player.contactOf.subarray(first, k + 1)].filter(contact => contact >= 0).flatMap(contactPoint);
  player.lines.forEach(line => gl.deleteBuffer(line.buffer));
  player.lines = [strip([[clampAt(first), clampAt(last)]], "#8a8a8a", 1.2)];
  player.lines.push(strip([rod.points], blue, 3.5), strip([[rod.base, plus(rod.base, rod.y, -0.07 * L)]], ink, 11));
  if (rod.touches) {
    // the longest arrow and the longest arc are those of the largest force and moment of the sweep
    const [force, moment] = player.largest[sweep].map(size => size || 1), scaled = rod.force.map(f => f * 0.35 * L / force);
    const arrows = [...arrow(rod.base, scaled, normal), ...arrow(rod.points[rod.contact], scaled.map(f => -f), normal)];
    player.lines.push(strip([...arrows, ...arc(rod, 1.6 * Math.PI * Math.hypot(...rod.moment) / moment)], purple, 2.5));
  }
  const points = new Float32Array(trace);
  player.trace = {points, color: selected, buffer: buffer(gl.ARRAY_BUFFER, points, player.trace?.buffer)};
  describe(k, sweep, rod);
  if (!curves.hidden) drawCurves(k, sweep);
}

function describe(k, sweep, rod) {
  const contact = player.contactOf[k], {columns} = contacts, kind = kindOf(contact);
  const in_slice = columns.slice && contact >= 0 ? columns.slice[contact] : null;
  const slice = in_slice === null ? "" : in_slice < 0 ? ", a probing" : `, slice ${in_slice}`;
  const what = contact < 0 ? "no contact" : kind ? kind + " contact" : "contact";
  const value = ([name, unit], i) => `${name} = ${number(player.reactions[player.width * k + i])} ${unit}`;
  const values = player.names.map(value).map(text => text.replaceAll(" ", "\u00a0")).join(", ");
  now.textContent = `sweep ${player.numbers[sweep]} (no. ${sweep + 1} of ${player.numbers.length}${player.moves} with contact)${slice}, `
    + `sample ${k - player.starts[sweep] + 1} of ${player.ends[sweep] - player.starts[sweep]}: ${what}`
    + `${rod.touches ? ` at ${number(rod.s1)} of the rod's length` : ""}; ${values}`;
  curves.setAttribute("aria-label", `reactions over the travel of the clamp; ${values}`);
}

function drawRod(view, ratio) {
  if (player.stale) buildRod();
  if (!player.on) return;
  for (const line of player.lines) drawLines(line, view, ratio, false);
  if (player.trace.points.length) drawPoints(player.trace, 6, view, ratio, false, 0.006);
}

// --- the curves ---

const ends = values => values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
const travelOf = sweep => player.travel.subarray(player.starts[sweep], player.ends[sweep]);

function ticks(low, high, most) {  // round numbers from low to high
  const length = high - low, power = 10 ** Math.floor(Math.log10(length / most));
  const step = power * [1, 2, 5, 10].find(k => length / (k * power) <= most), first = Math.ceil(low / step - 1e-9);
  return Array.from({length: Math.floor(high / step + 1e-9) - first + 1}, (_, k) => (first + k) * step);
}

function curveFrames() {  // places of the charts in CSS pixels
  const size = 0.82 * fontSize(), left = 3.4 * size, each = curves.clientWidth / player.labels.length;
  return player.labels.map((chart, i) => (
    {chart, size, x: i * each + left, w: each - left - size, y: 1.7 * size, h: curves.clientHeight - 4.4 * size}));
}

function drawCurves(k, sweep) {
  const first = player.starts[sweep], travel = travelOf(sweep);
  let column = 0;
  const values = column => travel.map((_, j) => player.reactions[player.width * (first + j) + column]);
  const charts = curveFrames().map(frame => chartText(frame, travel, frame.chart.names.map(() => values(column++)), k - first));
  curves.innerHTML = `<svg width="100%" height="100%">${charts.join("")}</svg>`;
}

function chartText({chart, size, x, y, w, h}, travel, rows, shown) {  // a chart as SVG
  const [near, far] = ends(travel), width = far - near || 1, [low, top] = ends([0, ...rows.flatMap(ends)]);
  const high = top > low ? top : low + 1, color = i => player.colors.curves[i];
  const px = t => x + w * (t - near) / width, py = v => y + h * (high - v) / (high - low);
  const line = (points, color, wide) => `<polyline points="${points.join(" ")}" stroke="${color}" stroke-width="${wide}"/>`;
  const text = (u, v, anchor, words) => `<text x="${u}" y="${v}" font-size="${size}" text-anchor="${anchor}">${words}</text>`;
  const names = chart.names.map((name, i) => `<tspan dx="${size / 2}" fill="${color(i)}">${name}</tspan>`);
  return [
    ...ticks(low, high, h > 7 * size ? 4 : 3).map(t => text(x - 4, py(t) + 0.35 * size, "end", number(t))
      + line([[x, py(t)], [x + w, py(t)]], "#d0d0d0", 1)),
    ...ticks(near, near + width, w / (5 * size)).map(t => text(px(t), y + h + 1.2 * size, "middle", number(t))),
    text(x + w / 2, y + h + 2.5 * size, "middle", (w > 13 * size ? "travel of the clamp in " : "travel in ") + data.unit),
    text(x, y - 0.6 * size, "start", chart.title + (rows.length > 1 ? names.join("") : "")),
    line([[px(travel[shown]), y], [px(travel[shown]), y + h]], paperOrInk("ink"), 1),
    ...rows.map((row, i) => line(Array.from(row, (value, j) => [px(travel[j]), py(value)]), color(i), 1.8)
      + `<circle cx="${px(travel[shown])}" cy="${py(row[shown])}" r="4" fill="${color(i)}"/>`),
  ].join("");
}

function sampleAtCurve(clientX) {  // the sample of the present sweep whose travel is nearest to a place in a chart
  const x = clientX - curves.getBoundingClientRect().left, travel = travelOf(player.sweep);
  const chart = curveFrames().reduce((a, b) => Math.abs(x - a.x - a.w / 2) <= Math.abs(x - b.x - b.w / 2) ? a : b);
  const [near, far] = ends(travel), at = near + (x - chart.x) / chart.w * (far - near);
  const nearest = travel.reduce((best, t, i) => Math.abs(t - at) < Math.abs(travel[best] - at) ? i : best, 0);
  return player.starts[player.sweep] + nearest;
}

// --- playing ---

function play(on = !player.playing) {
  player.playing = on; now.setAttribute("aria-live", on ? "off" : "polite");
  byId("play").textContent = on ? "❚❚" : "▶"; byId("play").setAttribute("aria-label", on ? "pause" : "play");
  if (!on) return;
  switchPlayer(true);
  if (player.sample === player.ends[player.sweep] - 1) goTo(player.sweep, 0);
  player.time = performance.now(); player.share = 0;
  requestAnimationFrame(advance);
}

function advance(time) {
  if (!player.playing) return;
  const count = player.ends[player.sweep] - player.starts[player.sweep];
  player.share += Math.max(0, time - player.time) / 1000 / byId("speed").value * count; player.time = time;
  const whole = Math.floor(player.share), next = player.sample - player.starts[player.sweep] + whole;
  player.share -= whole;
  if (whole) { goTo(player.sweep, next); if (next >= count) play(false); }
  requestAnimationFrame(advance);
}
