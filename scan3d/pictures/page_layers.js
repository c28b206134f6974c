// The layers: their colours by values, their legends with histograms, and their boxes in the panel.

function prepare(layer) {
  layer.points = new Float32Array(bytes(layer.position));
  layer.buffer = buffer(gl.ARRAY_BUFFER, layer.points);
  if (layer.index) {
    layer.faces = new Uint32Array(bytes(layer.index));
    layer.elements = buffer(gl.ELEMENT_ARRAY_BUFFER, layer.faces);
  }
  for (const scale of layer.colors || []) scale.values = new Float32Array(bytes(scale.values));
  layer.scale = (layer.colors || [])[0];
  if (layer.kind !== "lines") paint(layer);
}

function fraction(scale, value) {  // of the scale's length at which a value stands
  const f = scale.log ? Math.log : x => x, inside = Math.min(scale.high, Math.max(scale.low, value));
  return (f(inside) - f(scale.low)) / (f(scale.high) - f(scale.low));
}

function paint(layer) {
  const scale = layer.scale, n = layer.points.length / 3, tint = new Uint8Array(4 * n), grey = [0.6, 0.6, 0.6];
  const stops = scale ? (scale.stops || scale.kinds.map(kind => kind[1])).map(rgb) : [rgb(layer.color)];
  for (let k = 0; k < n; k++) {
    const value = scale ? scale.values[k] : 0;
    if (!scale || scale.kinds || !isFinite(value)) {
      const color = scale && !scale.kinds ? grey : stops[value];
      for (let i = 0; i < 3; i++) tint[4 * k + i] = Math.round(255 * color[i]);
      continue;
    }
    const at = fraction(scale, value) * (stops.length - 1), low = Math.min(Math.floor(at), stops.length - 2);
    for (let i = 0; i < 3; i++) {
      tint[4 * k + i] = Math.round(255 * (stops[low][i] + (at - low) * (stops[low + 1][i] - stops[low][i])));
    }
  }
  layer.tint = buffer(gl.ARRAY_BUFFER, tint, layer.tint);
}

const bins = 32;

function weights(layer) {  // the surface's area around each vertex; contacts count alike
  if (layer.weights) return layer.weights;
  const p = layer.points, weight = new Float64Array(p.length / 3);
  if (!layer.faces) return layer.weights = weight.fill(1);
  const corner = k => [p[3 * k], p[3 * k + 1], p[3 * k + 2]];
  for (let k = 0; k < layer.faces.length; k += 3) {
    const [a, b, c] = [0, 1, 2].map(i => corner(layer.faces[k + i]));
    const area = Math.hypot(...cross(plus(b, a, -1), plus(c, a, -1))) / 6;
    for (let i = 0; i < 3; i++) weight[layer.faces[k + i]] += area;
  }
  return layer.weights = weight;
}

function histogram(layer, scale) {  // shares in bins of equal length on the scale, the unknown share, and quantiles
  const shares = new Float64Array(bins), weight = weights(layer), known = [];
  let all = 0, unknown = 0;
  for (let k = 0; k < weight.length; k++) {
    all += weight[k];
    if (isFinite(scale.values[k])) {
      shares[Math.min(bins - 1, Math.floor(bins * fraction(scale, scale.values[k])))] += weight[k];
      known.push(k);
    } else unknown += weight[k];
  }
  known.sort((a, b) => scale.values[a] - scale.values[b]);
  const quantile = share => {
    let sum = 0;
    return scale.values[known.find(k => (sum += weight[k]) >= share * (all - unknown) * (1 - 1e-9))];
  };
  return {shares: shares.map(share => share / all), unknown: unknown / all, quantile};
}

const percent = share => (100 * share >= 10 ? Math.round(100 * share) : number(100 * share)) + " %";

function add(parent, kind, name, text = "") {
  const element = parent.appendChild(document.createElement(kind));
  element.className = name; element.textContent = text;
  return element;
}

function legend(place, layer) {
  const scale = layer.scale;
  place.replaceChildren();
  if (!scale) return;
  if (scale.kinds) {
    scale.kinds.forEach(([text, color], kind) => {
      const row = add(place, "div", ""), count = scale.values.reduce((sum, value) => sum + (value === kind), 0);
      add(row, "span", "dot").style.background = color;
      row.append(text + ": " + count + " (" + percent(count / scale.values.length) + ")");
    });
    return;
  }
  const {shares, unknown, quantile} = histogram(layer, scale), most = Math.max(...shares);
  const what = layer.faces ? "of the area" : "of the contacts", bars = add(place, "div", "histogram");
  const text = `5 %, 50 % and 95 % ${what} are below ${[0.05, 0.5, 0.95].map(share => number(quantile(share))).join(", ")}`;
  bars.setAttribute("role", "img"); bars.setAttribute("aria-label", `histogram of ${scale.title}: ${text}`);
  const middle = k => (k + 0.5) / bins, value = t => scale.log ? scale.low * (scale.high / scale.low) ** t
    : scale.low + t * (scale.high - scale.low);
  shares.forEach((share, k) => {
    const bar = add(bars, "span", "");
    bar.style.height = 100 * share / most + "%";
    bar.title = `${number(value(k / bins))} to ${number(value((k + 1) / bins))}: ${percent(share)} ${what}`;
    bar.dataset.share = share; bar.dataset.at = value(middle(k));
  });
  add(place, "div", "bar").style.background = "linear-gradient(to right," + scale.stops.join() + ")";
  const ends = add(place, "div", "ends");
  for (const end of scale.log ? [scale.low, scale.high] : [scale.low, (scale.low + scale.high) / 2, scale.high]) {
    add(ends, "span", "", number(end));
  }
  add(place, "div", "note", text + (unknown ? `; unknown (grey): ${percent(unknown)}` : "") + `; highest bar ${percent(most)}`);
}

function box(name, on, change) {
  const label = byId("layers").appendChild(document.createElement("label")), input = document.createElement("input");
  input.type = "checkbox"; input.checked = on; input.name = name;
  input.onchange = () => { change(input.checked); redraw(); };
  label.append(input, " " + name);
  return input;
}

function controls() {
  const place = byId("layers");
  for (const layer of data.layers) {
    box(layer.name, !!layer.on, on => { layer.on = on; });
    if (!(layer.colors || []).length) continue;
    const choice = document.createElement("select"), key = document.createElement("div");
    choice.setAttribute("aria-label", "colour of " + layer.name); key.className = "legend";
    for (const scale of [...layer.colors, null]) choice.add(new Option(scale ? scale.title : "plain"));
    choice.onchange = () => {
      layer.scale = layer.colors[choice.selectedIndex];
      paint(layer); legend(key, layer); redraw();
    };
    legend(key, layer); place.append(choice, key);
  }
  if (player) {
    player.box = box("rod, clamp and reactions", false, on => switchPlayer(on));
    const key = add(place, "div", "key"), {rod, force, selected} = player.colors;
    for (const [color, text] of [[rod, "rod"], [force, "force and moment at the clamp, force of the contact on the rod"],
      [selected, "contacts of the sweep so far"]]) {
      const row = add(key, "div", ""); add(row, "span", "dot").style.background = color; row.append(text);
    }
    box("rods along the sweep", false, on => { player.trail = on; if (on) switchPlayer(true); player.stale = true; });
  }
  box("axes and scale", true, on => { marks.on = on; });
}
