// The layers: their colours by values, their legends with histograms, and their boxes in the panel.

function prepare(layer) {
  layer.buffer = buffer(gl.ARRAY_BUFFER, layer.points, layer.buffer);
  const golden = k => 0.6180339887 * k % 1;  // contacts in an order whose beginnings are spread evenly along the sweeps
  if (layer.kind === "points") layer.order = Uint32Array.from(layer.points.slice(0, layer.points.length / 3).keys())
    .sort((a, b) => golden(a) - golden(b));
  if (layer.faces || layer.order) layer.elements = buffer(gl.ELEMENT_ARRAY_BUFFER, layer.faces || layer.order, layer.elements);
  layer.scale = layer.colors?.[layer.chosen ?? 0];
  if (layer.kind !== "lines") paint(layer);
}

function fraction(scale, value) {  // of the scale's length at which a value stands
  const f = scale.log ? Math.log : x => x, inside = Math.min(scale.high, Math.max(scale.low, value));
  return (f(inside) - f(scale.low)) / (f(scale.high) - f(scale.low));
}

function colorOf(scale, stops, value) {  // red, green and blue; grey if it is not known
  if (scale.kinds) return stops[value];
  if (!isFinite(value)) return [0.6, 0.6, 0.6];
  const at = fraction(scale, value) * (stops.length - 1), below = Math.min(Math.floor(at), stops.length - 2);
  return plus(stops[below], minus(stops[below + 1], stops[below]), at - below);
}

function paint(layer) {
  const {scale} = layer, n = layer.points.length / 3, tint = new Uint8Array(4 * n);
  const stops = scale && (scale.stops || scale.kinds.map(kind => kind[1])).map(rgb), plain = rgb(layer.color);
  for (let k = 0; k < n; k++) {
    const color = scale ? colorOf(scale, stops, scale.values[k]) : plain;
    for (let i = 0; i < 3; i++) tint[4 * k + i] = Math.round(255 * color[i]);
  }
  layer.tint = buffer(gl.ARRAY_BUFFER, tint, layer.tint);
}

// A value on a scale; what is a millionth of the scale is rounding.
const valueOf = (scale, value) => number(scale.kinds || Math.abs(value) > 1e-6 * Math.max(-scale.low, scale.high) ? value : 0);
const percent = share => (100 * share >= 10 ? Math.round(100 * share) : number(100 * share, 2)) + " %";

function add(parent, kind, name, text = "") {
  const element = parent.appendChild(document.createElement(kind));
  element.className = name; element.textContent = text;
  return element;
}

function dotted(place, color, text) {  // a line of a legend
  const row = add(place, "div", "");
  add(row, "span", "dot").style.background = color; row.append(text);
}

const whatOf = layer => layer.faces ? "of the area" : "of the contacts";
const valueAt = ({low, high, log}, t) => log ? low * (high / low) ** t : low + t * (high - low);

function key(place, layer) {  // what the colours mean
  const {scale} = layer;
  if (scale.kinds) {
    // how much of the surface is of which kind the headline says
    for (const [text, color, size] of scale.kinds) dotted(place, color, layer.faces ? text : `${text}: ${percent(size)} ${whatOf(layer)}`);
    return;
  }
  add(place, "div", "bar").style.background = "linear-gradient(to right," + scale.stops.join() + ")";
  const ends = add(place, "div", "ends");
  // values beyond the scale have the colours of its ends
  const sign = t => t === 0 && scale.beyond[0] ? "≤ " : t === 1 && scale.beyond[1] ? "≥ " : "";
  for (const t of scale.log ? [0, 1] : [0, 0.5, 1]) add(ends, "span", "", sign(t) + number(valueAt(scale, t)));
}

function brief(layer) {  // what is to be seen without the panel
  const place = byId("brief");
  place.replaceChildren();
  if (!layer.scale) return;
  add(place, "div", "", layer.scale.title); key(place, layer);
}

function legend(place, layer) {
  const {scale} = layer, what = whatOf(layer);
  place.replaceChildren();
  if (!scale) return;
  if (scale.kinds) { key(place, layer); return; }
  const {shares, quantiles, unknown} = scale, most = Math.max(...shares), bars = add(place, "div", "histogram");
  const unit = scale.title.match(/ in \S+$/)?.[0].slice(3) ?? "", than = scale.low < 0 ? "within ±" : "below ";
  const [half, nearly] = quantiles.map(value => `${valueOf(scale, value)} ${unit}`.trim());
  const text = `half ${what} is ${than}${half}, 95 % ${than}${nearly}`;
  bars.setAttribute("role", "img"); bars.setAttribute("aria-label", `histogram of ${scale.title}: ${text}`);
  const value = t => valueAt(scale, t);
  shares.forEach((share, k) => {
    const bar = add(bars, "span", "");
    bar.style.height = 100 * share / most + "%"; bar.dataset.share = share;
    bar.title = `${[k, k + 1].map(edge => number(value(edge / shares.length))).join(" to ")}: ${percent(share)} ${what}`;
  });
  key(place, layer);
  const grey = unknown ? `; unknown (grey): ${percent(unknown)}` : "";
  add(place, "div", "note", text + grey);
}

function box(name, on, change) {
  const label = add(byId("layers"), "label", ""), input = add(label, "input", "");
  input.type = "checkbox"; input.checked = on; input.name = name;
  input.onchange = () => { change(input.checked); redraw(); };
  label.append(" " + name);
  return input;
}

function controls() {
  const place = byId("layers"), first = data.layers.find(layer => layer.scale);
  if (first) brief(first);
  for (const layer of data.layers) {
    box(layer.name, !!layer.on, on => { layer.on = on; });
    if (!layer.scale) continue;
    const choice = add(place, "select", ""), key = add(place, "div", "legend");
    choice.setAttribute("aria-label", "colour of " + layer.name);
    for (const scale of [...layer.colors, null]) choice.add(new Option(scale ? scale.title : "plain"));
    choice.onchange = () => {
      layer.chosen = choice.selectedIndex; layer.scale = layer.colors[layer.chosen];
      paint(layer); legend(key, layer); redraw();
      if (layer === first) brief(layer);
    };
    legend(key, layer); layer.legend = key;
  }
  if (player) {
    player.box = box("rod, clamp and reactions", player.on, on => switchPlayer(on));
    const key = add(place, "div", "key"), {rod, force, selected} = player.colors;
    dotted(key, rod, "rod"); dotted(key, force, "force and moment at the clamp, force of the contact on the rod");
    dotted(key, selected, "contacts of the sweep so far");
  }
  box("axes and scale", true, on => { marks.on = on; });
}
