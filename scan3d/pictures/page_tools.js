// Tools: picking, distances, the cutting plane, and the marks drawn over the picture.
const contacts = data.layers.find(layer => layer.kind === "points");
const marks = {canvas: byId("marks"), on: true, contact: -1, points: [], measuring: false};
const cutOff = p => dot(cutting.normal, p) > cutting.offset;

function surfaceAt(x, y) {  // the nearest point of a visible body under a place of the window, and its depth; null beside it
  let found = null;
  for (const layer of data.layers) {
    const {kind, on, points, faces} = layer;
    if (kind !== "triangles" || !on) continue;
    const placed = onScreen(points);
    for (let k = 0; k < faces.length; k += 3) {
      const i = 3 * faces[k], j = 3 * faces[k + 1], l = 3 * faces[k + 2];
      const area = (a, b) => (placed[a] - x) * (placed[b + 1] - y) - (placed[a + 1] - y) * (placed[b] - x);
      const u = area(j, l), v = area(l, i), w = area(i, j), sum = u + v + w;
      if (!(sum !== 0 && u * sum >= 0 && v * sum >= 0 && w * sum >= 0)) continue;
      const at = (values, c) => (u * values[i + c] + v * values[j + c] + w * values[l + c]) / sum, depth = at(placed, 2);
      const point = [0, 1, 2].map(c => at(points, c));
      if (!(found && depth <= found.depth) && !cutOff(point)) {
        const value = values => (u * values[i / 3] + v * values[j / 3] + w * values[l / 3]) / sum;
        found = {point, depth, name: layer.name, values: (layer.colors || []).map(scale => [scale, value(scale.values)])};
      }
    }
  }
  return found;
}

function contactAt(x, y) {  // the contact in front at a place of the window, within its drawn size; -1 for none
  if (!(contacts && contacts.on)) return -1;
  const placed = onScreen(contacts.points);
  let best = -1;
  for (let i = 0; i < contacts.shown; i++) {
    const k = 3 * contacts.order[i];
    if ((placed[k] - x) ** 2 + (placed[k + 1] - y) ** 2 >= 36) continue;
    if ((best < 0 || placed[k + 2] > placed[best + 2]) && !cutOff(contactPoint(k / 3))) best = k;
  }
  const body = best < 0 ? null : surfaceAt(x, y);
  // contacts lie on the surface, and are hidden by it only if they are clearly behind it
  return best < 0 || body && body.depth > placed[best + 2] + 0.03 * data.radius ? -1 : best / 3;
}

const contactPoint = contact => [...contacts.points.subarray(3 * contact, 3 * contact + 3)];
const decimals = Math.max(0, 5 - Math.floor(Math.log10(2 * data.radius)));
const coordinate = v => String(+v.toFixed(decimals) || 0).replaceAll("-", "−") + " " + data.unit;
const placeText = p => p.map((v, i) => "xyz"[i] + " = " + coordinate(v + data.center[i]));
const valueText = ({title, ...scale}, value) => {  // "name: value unit" of a title "name in unit"; bounds are rounded up
  const [, name, unit] = title.match(/^(.*?)(?: in (\S+))?$/), size = data.units.find(([symbol]) => symbol === unit)?.[1];
  if (scale.kinds) return name + ": " + scale.kinds[Math.round(value)][0];
  if (!isFinite(value)) return name + ": unknown";
  return name + ": " + (size ? lengthText(value * size, 3, name.startsWith("certified"))
    : valueOf(scale, value) + (unit ? " " + unit : ""));
};

function showContact(contact) {
  picked.hidden = contact < 0;
  if (contact < 0) return;
  const rows = Object.entries(contacts.columns).map(([name, values]) => name + " " + values[contact]);
  const measured = contacts.colors.map(scale => valueText(scale, scale.values[contact]));
  picked.textContent = ["contact " + contact, ...placeText(contactPoint(contact)), ...rows, ...measured].join("\n");
}

function click(x, y) {
  const contact = contactAt(x, y);
  if (marks.measuring) {
    const body = contact < 0 ? surfaceAt(x, y) : {point: contactPoint(contact)};
    if (body) mark(body.point);
    return;
  }
  marks.contact = contact; marks.points = [];
  showContact(contact);
  const body = contact < 0 ? surfaceAt(x, y) : null;
  if (body) {
    marks.points = [body.point]; picked.hidden = false;
    picked.textContent = [body.name, ...placeText(body.point), ...body.values.map(pair => valueText(...pair))].join("\n");
  }
  if (player && contact >= 0) { play(false); goToSample(player.contact[contact]); }
  redraw();
}

// --- distances ---

function mark(point) {  // one of two points, between which the distance is shown
  if (marks.points.length === 2) marks.points = [];
  marks.points.push(point);
  const [a, b] = marks.points, text = ["first point", ...placeText(a)];
  if (b) {
    text.push("second point", ...placeText(b), `distance = ${distanceText()}`,
      ...minus(b, a).map((v, i) => `Δ${"xyz"[i]} = ${coordinate(v)}`));
  } else text.push("pick the second point");
  picked.hidden = false; picked.textContent = text.join("\n");
  redraw();
}

const distanceText = () => lengthText(Math.hypot(...minus(marks.points[1], marks.points[0])), 5);

function measuring(on = !marks.measuring) {
  marks.measuring = on; marks.points = []; canvas.classList.toggle("measuring", on);
  byId("measure").setAttribute("aria-pressed", on);
  picked.hidden = !on; picked.textContent = on ? "pick the first point: a contact, or a place on the surface" : "";
  redraw();
}

// --- the cutting plane ---

function cut() {  // as the controls say, in every frame
  const name = byId("cut-axis").value, axis = "xyz".indexOf(name), sign = byId("cut-flip").checked ? -1 : 1, m = turned();
  const at = (2 * byId("cut-at").value / 1000 - 1) * data.radius;
  byId("cut-more").hidden = !name;
  if (!name) { Object.assign(cutting, {normal: [0, 0, 0], offset: 0}); return; }
  const normal = name === "view" ? [m[2], m[5], m[8]] : [0, 1, 2].map(i => +(i === axis));
  Object.assign(cutting, {normal: normal.map(v => sign * v), offset: sign * at});
  const text = name === "view" ? `${lengthText(at)} in front of the centre`
    : `${name} = ${lengthText(at + data.center[axis])}`;
  byId("cut-text").textContent = text; byId("cut-at").setAttribute("aria-valuetext", text);
}

// --- marks over the picture ---

function drawMarks(view, ratio) {
  const over = marks.canvas, context = over.getContext("2d");
  over.width = Math.round(view.w * ratio); over.height = Math.round(view.h * ratio);  // which empties it
  context.scale(ratio, ratio);
  const size = fontSize(), shown = player && player.on ? player.contactOf[player.sample] : -1;
  const twice = (wide, paint) => {  // ink on paper, which is seen on any colour
    for (const [width, color] of [[wide, paperOrInk("paper")], [2, paperOrInk("ink")]]) {
      context.lineWidth = width; context.strokeStyle = color; context.beginPath(); paint(); context.stroke();
    }
  };
  context.font = `${size}px system-ui, sans-serif`; context.lineJoin = "round";
  if (marks.on) { paintAxes(context, view, size); paintScale(context, view, size); }
  for (const contact of new Set(contacts && contacts.on ? [marks.contact, shown] : [])) {
    if (contact < 0) continue;
    const [x, y] = onScreen(contactPoint(contact));
    twice(4.5, () => context.arc(x, y, 8, 0, 2 * Math.PI));
  }
  const ends = marks.points.map(point => onScreen(point));
  twice(5, () => {
    for (const [x, y] of ends) {
      context.moveTo(x - 6, y - 6); context.lineTo(x + 6, y + 6); context.moveTo(x - 6, y + 6); context.lineTo(x + 6, y - 6);
    }
    if (ends.length === 2) { context.moveTo(ends[0][0], ends[0][1]); context.lineTo(ends[1][0], ends[1][1]); }
  });
  if (ends.length === 2) {
    outlined(context, distanceText(), (ends[0][0] + ends[1][0]) / 2, (ends[0][1] + ends[1][1]) / 2 - size, "center");
  }
}

function outlined(context, text, x, y, align) {
  context.textAlign = align; context.textBaseline = "middle";
  context.strokeStyle = paperOrInk("paper"); context.lineWidth = 4; context.strokeText(text, x, y);
  context.fillStyle = paperOrInk("ink"); context.fillText(text, x, y);
}

function paintAxes(context, view, size) {
  const arm = 34, x = view.left + arm + 2 * size, y = view.h - view.bottom - arm - 1.4 * size, m = turned();
  for (const i of [0, 1, 2].sort((a, b) => m[3 * a + 2] - m[3 * b + 2])) {  // from behind to the front
    const to = [m[3 * i], -m[3 * i + 1]], length = Math.hypot(...to);
    context.strokeStyle = paperOrInk("ink"); context.lineWidth = 2;
    context.beginPath(); context.moveTo(x, y); context.lineTo(x + arm * to[0], y + arm * to[1]); context.stroke();
    const reach = arm + 0.7 * size / length;  // an axis that is seen from its end has no letter
    if (length > 0.15) outlined(context, "xyz"[i], x + reach * to[0], y + reach * to[1], "center");
  }
}

function paintScale(context, view, size) {  // the longest round length of up to 160 pixels
  const longest = 160 / view.unit, power = 10 ** Math.floor(Math.log10(longest));
  const length = [5, 2, 1].find(k => k * power <= longest) * power, x = view.w - 24, y = view.h - view.bottom - 14;
  context.strokeStyle = paperOrInk("ink"); context.lineWidth = 3;
  context.beginPath(); context.moveTo(x - length * view.unit, y); context.lineTo(x, y); context.stroke();
  outlined(context, lengthText(length), x - length * view.unit / 2, y - 0.8 * size, "center");
}
