// Tools: picking, distances, the cutting plane, the marks drawn over the picture, and the picture as a file.
// CSS pixels: the longest scale, the distance at which a contact is still picked (about its drawn size), the arms of the axes.
const longestScale = 160, pickDistance = 6, arm = 34;
// What lies behind a surface by less than this fraction of the radius is not hidden by it: contacts lie on the surface.
const hiddenBy = 0.03;
const marks = {canvas: byId("marks"), on: true, hovered: -1, points: [], measuring: false};
const contactLayer = () => data.layers.find(layer => layer.kind === "points" && layer.on);
const cutOff = p => dot(cutting.normal, p) > cutting.offset;

function surfaceAt(x, y) {  // the nearest point of a visible body under a place of the window, and its depth; null beside it
  const m = turned(), view = measures();
  const u = (x - view.x) / view.unit, v = (view.y - y) / view.unit;
  let found = null, front = -Infinity;
  for (const layer of data.layers) {
    if (layer.kind !== "triangles" || !layer.on) continue;
    const p = layer.points, n = p.length / 3, a = new Float64Array(n), b = new Float64Array(n), d = new Float64Array(n);
    for (let k = 0; k < n; k++) {
      const [i, j, l] = [p[3 * k], p[3 * k + 1], p[3 * k + 2]];
      a[k] = m[0] * i + m[3] * j + m[6] * l - u; b[k] = m[1] * i + m[4] * j + m[7] * l - v;
      d[k] = m[2] * i + m[5] * j + m[8] * l;
    }
    for (let k = 0; k < layer.faces.length; k += 3) {
      const [i, j, l] = [layer.faces[k], layer.faces[k + 1], layer.faces[k + 2]];
      const wi = a[j] * b[l] - a[l] * b[j], wj = a[l] * b[i] - a[i] * b[l], wl = a[i] * b[j] - a[j] * b[i], sum = wi + wj + wl;
      if (!(sum !== 0 && wi * sum >= 0 && wj * sum >= 0 && wl * sum >= 0)) continue;
      const depth = (wi * d[i] + wj * d[j] + wl * d[l]) / sum;
      if (depth <= front) continue;
      const at = c => (wi * p[3 * i + c] + wj * p[3 * j + c] + wl * p[3 * l + c]) / sum, point = [at(0), at(1), at(2)];
      if (!cutOff(point)) { found = {point, depth}; front = depth; }
    }
  }
  return found;
}

function contactAt(x, y) {  // the contact in front at a place of the window, -1 for none
  const layer = contactLayer(), m = turned(), view = measures(), p = layer ? layer.points : [];
  let best = -1, front = -Infinity;
  for (let k = 0; k < p.length; k += 3) {
    const dx = view.x + (m[0] * p[k] + m[3] * p[k + 1] + m[6] * p[k + 2]) * view.unit - x;
    if (dx > pickDistance || dx < -pickDistance) continue;
    const dy = view.y - (m[1] * p[k] + m[4] * p[k + 1] + m[7] * p[k + 2]) * view.unit - y;
    if (dx * dx + dy * dy >= pickDistance * pickDistance) continue;
    const d = m[2] * p[k] + m[5] * p[k + 1] + m[8] * p[k + 2];
    if (d > front && !cutOff([p[k], p[k + 1], p[k + 2]])) { best = k / 3; front = d; }
  }
  if (best < 0) return -1;
  const body = surfaceAt(x, y);
  return body && body.depth > front + hiddenBy * data.radius ? -1 : best;
}

const contactPoint = contact => [...contactLayer().points.subarray(3 * contact, 3 * contact + 3)];
const placeText = p => p.map((v, i) => "xyz"[i] + " = " + (v + data.center[i]).toPrecision(6) + " " + data.unit);

function showContact(contact) {
  picked.hidden = contact < 0;
  if (contact < 0) return;
  const layer = contactLayer(), rows = Object.entries(layer.columns).map(([name, values]) => name + " " + values[contact]);
  const measured = layer.colors.map(scale => scale.title + ": " + (scale.kinds ? scale.kinds[scale.values[contact]][0]
    : isFinite(scale.values[contact]) ? number(scale.values[contact]) : "unknown"));
  picked.textContent = ["contact " + contact, ...placeText(contactPoint(contact)), ...rows, ...measured].join("\n");
}

function click(x, y) {
  const contact = contactAt(x, y);
  if (marks.measuring) {
    const body = contact < 0 ? surfaceAt(x, y) : null;
    if (contact >= 0 || body) mark(contact >= 0 ? contactPoint(contact) : body.point);
    return;
  }
  marks.hovered = contact;
  showContact(contact);
  if (player && contact >= 0) { play(false); goToSample(player.contact[contact]); }
  redraw();
}

function hover(x, y) {
  const contact = x === null ? -1 : contactAt(x, y);
  if (contact === marks.hovered) return;
  marks.hovered = contact;
  if (player && player.on) preview(contact < 0 ? -1 : player.contact[contact]);
  redraw();
}

// --- distances ---

function mark(point) {  // one of two points, between which the distance is shown
  if (marks.points.length === 2) marks.points = [];
  marks.points.push(point);
  const [a, b] = marks.points, text = ["first point", ...placeText(a)];
  if (b) {
    const apart = plus(b, a, -1);
    text.push("second point", ...placeText(b), `distance = ${Math.hypot(...apart).toPrecision(5)} ${data.unit}`,
      ...apart.map((v, i) => `Δ${"xyz"[i]} = ${v.toPrecision(4)} ${data.unit}`));
  } else text.push("pick the second point");
  picked.hidden = false; picked.textContent = text.join("\n");
  redraw();
}

function measuring(on = !marks.measuring) {
  marks.measuring = on; marks.points = []; canvas.classList.toggle("measuring", on);
  byId("measure").setAttribute("aria-pressed", on);
  picked.hidden = !on; picked.textContent = on ? "pick the first point: a contact, or a place on the surface" : "";
  redraw();
}

// --- the cutting plane ---

function cut() {
  const axis = byId("cut-axis").value, at = 2 * byId("cut-at").value / 1000 - 1, sign = byId("cut-flip").checked ? -1 : 1;
  byId("cut-more").hidden = !axis;
  const set = () => {
    const m = turned(), normal = axis === "view" ? [m[2], m[5], m[8]] : [0, 1, 2].map(i => +("xyz"[i] === axis));
    cutting.normal = normal.map(v => sign * v); cutting.offset = sign * at * data.radius;
  };
  cutting.follow = axis === "view" ? set : null;
  if (axis) set(); else { cutting.normal = [0, 0, 0]; cutting.offset = 0; }
  const at3 = "xyz".indexOf(axis) < 0 ? at * data.radius : at * data.radius + data.center["xyz".indexOf(axis)];
  const text = axis === "view" ? `${number(at3)} ${data.unit} in front of the centre` : `${axis} = ${number(at3)} ${data.unit}`;
  byId("cut-text").textContent = text; byId("cut-at").setAttribute("aria-valuetext", text);
  redraw();
}

// --- marks over the picture ---

function drawMarks(view, ratio) {
  const {canvas: over} = marks;
  const width = Math.round(view.w * ratio), height = Math.round(view.h * ratio);
  if (over.width !== width || over.height !== height) { over.width = width; over.height = height; }
  const context = over.getContext("2d");
  context.clearRect(0, 0, over.width, over.height);
  paintMarks(context, view, ratio);
}

function paintMarks(context, view, ratio) {
  const size = fontSize();
  context.save(); context.scale(ratio, ratio);
  context.font = `${size}px system-ui, sans-serif`; context.lineJoin = "round";
  if (marks.on) { paintAxes(context, view, size); paintScale(context, view, size); }
  const m = turned(), layer = contactLayer(), shown = player && player.on ? player.contactOf[shownSample()] : -1;
  for (const contact of new Set([marks.hovered, shown])) {
    if (contact < 0 || !layer) continue;
    const [x, y] = onScreen(contactPoint(contact), m, view);
    for (const [width, color] of [[4.5, "#fff"], [2, "#222"]]) {
      context.lineWidth = width; context.strokeStyle = color;
      context.beginPath(); context.arc(x, y, 8, 0, 2 * Math.PI); context.stroke();
    }
  }
  const ends = marks.points.map(point => onScreen(point, m, view));
  for (const [width, color] of [[5, "#fff"], [2, "#222"]]) {
    context.lineWidth = width; context.strokeStyle = color; context.beginPath();
    for (const [x, y] of ends) {
      context.moveTo(x - 6, y - 6); context.lineTo(x + 6, y + 6); context.moveTo(x - 6, y + 6); context.lineTo(x + 6, y - 6);
    }
    if (ends.length === 2) { context.moveTo(ends[0][0], ends[0][1]); context.lineTo(ends[1][0], ends[1][1]); }
    context.stroke();
  }
  if (ends.length === 2) {
    const text = Math.hypot(...plus(marks.points[1], marks.points[0], -1)).toPrecision(5) + " " + data.unit;
    outlined(context, text, (ends[0][0] + ends[1][0]) / 2, (ends[0][1] + ends[1][1]) / 2 - size, "center");
  }
  context.restore();
}

function outlined(context, text, x, y, align, color = "#222") {
  context.textAlign = align; context.textBaseline = "middle";
  context.strokeStyle = "#fff"; context.lineWidth = 4; context.strokeText(text, x, y);
  context.fillStyle = color; context.fillText(text, x, y);
}

function paintAxes(context, view, size) {
  const x = view.left + arm + 2 * size, y = view.h - view.bottom - arm - 1.4 * size, m = turned();
  const arms = [0, 1, 2].map(i => ({name: "xyz"[i], to: [m[3 * i], -m[3 * i + 1]], depth: m[3 * i + 2]}));
  const letters = [];
  for (const {name, to} of arms.sort((a, b) => a.depth - b.depth)) {
    const length = Math.hypot(...to);
    context.strokeStyle = "#222"; context.lineWidth = 2;
    context.beginPath(); context.moveTo(x, y); context.lineTo(x + arm * to[0], y + arm * to[1]); context.stroke();
    if (length < 0.15) continue;  // seen along the axis, its letter would lie on the others
    let beyond = 0.7, place;
    do {  // farther out, if another letter is there
      place = [0, 1].map(i => [x, y][i] + (arm + beyond * size / length) * to[i]); beyond += 0.4;
    } while (letters.some(other => Math.hypot(place[0] - other[0], place[1] - other[1]) < 0.9 * size));
    letters.push(place); outlined(context, name, ...place, "center");
  }
}

function paintScale(context, view, size) {
  const longest = longestScale / view.unit, power = 10 ** Math.floor(Math.log10(longest));
  const length = [5, 2, 1].find(k => k * power <= longest) * power, x = view.w - 24, y = view.h - view.bottom - 14;
  context.strokeStyle = "#222"; context.lineWidth = 3;
  context.beginPath(); context.moveTo(x - length * view.unit, y); context.lineTo(x, y); context.stroke();
  outlined(context, number(length) + " " + data.unit, x - length * view.unit / 2, y - 0.8 * size, "center");
}

// --- the picture as a file ---

function picture() {  // a canvas with what is seen, without the controls, and with the scales of colours
  draw();
  const made = document.createElement("canvas"), context = made.getContext("2d"), ratio = window.devicePixelRatio || 1;
  const view = measures();
  made.width = canvas.width; made.height = Math.round(canvas.height - view.bottom * ratio);  // not the place of the player
  context.drawImage(canvas, 0, 0);
  paintMarks(context, view, ratio);
  const size = fontSize(), x = 16;
  let y = 16 + size / 2;
  context.scale(ratio, ratio);
  context.font = `600 ${1.2 * size}px system-ui, sans-serif`; outlined(context, data.name, x, y, "left");
  context.font = `${size}px system-ui, sans-serif`;
  for (const layer of data.layers) {
    if (!layer.on || !layer.scale) continue;
    const {title, kinds, stops, low, high, log} = layer.scale;
    outlined(context, title, x, y += 2 * size, "left"); y += 1.3 * size;
    for (const [i, [text, color]] of (kinds || []).entries()) {
      if (i) y += 1.3 * size;
      context.fillStyle = color; context.beginPath(); context.arc(x + 6, y, 5, 0, 2 * Math.PI); context.fill();
      outlined(context, text, x + 18, y, "left");
    }
    if (kinds) continue;
    const ramp = context.createLinearGradient(x, 0, x + 200, 0);
    stops.forEach((color, k) => ramp.addColorStop(k / (stops.length - 1), color));
    context.fillStyle = ramp; context.fillRect(x, y - 6, 200, 12); y += 1.3 * size;
    outlined(context, number(low), x, y, "left"); outlined(context, number(high), x + 200, y, "right");
    if (!log) outlined(context, number((low + high) / 2), x + 100, y, "center");
  }
  return made;
}

function save() {
  picture().toBlob(blob => {
    const link = document.createElement("a"), place = URL.createObjectURL(blob);
    link.href = place; link.download = data.name.replace(/[^\w.-]+/g, "_") + ".png"; link.click();
    setTimeout(() => URL.revokeObjectURL(place), 60000);
  }, "image/png");
}
