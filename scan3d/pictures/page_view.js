// The camera, and what WebGL draws: triangles, points and lines in the coordinates of the scan about its centre.
const byId = id => document.getElementById(id);
const canvas = byId("view"), panel = byId("panel"), dock = byId("dock"), picked = byId("picked");
const gl = canvas.getContext("webgl2", {antialias: false});
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer;
const parsed = text => JSON.parse(text, (_, value) => value?.f4 !== undefined ? new Float32Array(bytes(value.f4))
  : value?.u4 !== undefined ? new Uint32Array(bytes(value.u4)) : value);
const data = parsed(byId("data").textContent);
const rgb = hex => [1, 3, 5].map(k => parseInt(hex.slice(k, k + 2), 16) / 255);
const plus = (a, b, t = 1) => [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]];
const minus = (a, b) => plus(a, b, -1);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unitVector = a => a.map(x => x / (Math.hypot(...a) || 1));
const fontSize = () => parseFloat(getComputedStyle(document.body).fontSize);
// Numbers as `scan3d.units` writes them.
const number = (x, digits = 3, up = false) => {
  if (x === 0) return "0";
  let rounded = +x.toPrecision(digits);
  if (up && rounded < x) rounded = +(rounded + 10 ** (Math.floor(Math.log10(Math.abs(x))) - digits + 1)).toPrecision(digits);
  return (Math.abs(x) >= 1e-4 && Math.abs(x) < 1e9 ? rounded.toLocaleString("en", {maximumSignificantDigits: digits})
    : rounded.toExponential().replace(/e([+-])(\d)$/, "e$10$2")).replaceAll("-", "−");
};
const lengthText = (x, digits = 3, up = false) => {
  const [symbol, size] = data.units.find(([symbol, size]) => symbol === "in" || Math.abs(x) >= size) || ["", 0];
  return size ? number(x / size, digits, up) + " " + symbol : x ? "under 1 nm" : "0 " + data.unit;
};
const paperOrInk = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
// A window up to this width, in CSS pixels, is that of a phone: the panel then covers the body instead of standing beside it.
const narrow = 700;
// Pixels across each CSS pixel: two smooth the edges.  Where frames come late, as without a graphics processor, there are fewer,
// and the surface is coarser, as long as the picture moves.
const ratios = [Math.max(2, window.devicePixelRatio || 1), 0.75, 0.5];

const head = `#version 300 es
precision highp float; uniform mat3 turn; uniform vec2 scale, shift; uniform float depth; uniform vec4 cut; out float beyond;
vec4 place(vec3 p) { vec3 q = turn * p; return vec4(q.xy * scale + shift, -q.z * depth, 1.0); }
float side(vec3 p) { return dot(cut.xyz, p) - cut.w; }`;
const programs = gl && {
  triangles: program(head + `
in vec3 position; in vec3 tint; out vec3 seen, shade;
void main() { seen = turn * position; shade = tint; beyond = side(position); gl_Position = place(position); }`, `
in vec3 seen, shade; uniform float alpha; out vec4 color;
void main() { if (beyond > 0.0) discard; vec3 n = normalize(cross(dFdx(seen), dFdy(seen)));
  float light = 0.5 + 0.5 * max(dot(n, normalize(vec3(0.25, 0.45, 0.86))), 0.0);
  vec3 front = gl_FrontFacing ? shade : mix(vec3(0.62, 0.58, 0.5), shade, 0.25);
  color = vec4(front * light, alpha); }`),
  points: program(head + `
in vec3 position; in vec3 tint; out vec3 shade; uniform float size, nearer;
void main() { shade = tint; beyond = side(position); gl_Position = place(position); gl_Position.z -= nearer;
  gl_PointSize = size; }`, `
in vec3 shade; uniform float core; out vec4 color;
void main() { if (beyond > 0.0) discard; vec2 d = 2.0 * gl_PointCoord - 1.0; float r = dot(d, d); if (r > 1.0) discard;
  vec3 rim = vec3(dot(shade, vec3(0.3, 0.6, 0.1)) < 0.5 ? 0.96 : 0.1);
  gl_FragDepth = gl_FragCoord.z + (r > core ? 0.001 : 0.0);  // the rim of a point covers no neighbour
  color = vec4(r > core ? rim : shade * (0.75 + 0.25 * sqrt(1.0 - r)), 1.0); }`),
  lines: program(head + `
in vec3 begin, end; uniform vec2 pixel; uniform float width;
void main() { vec4 a = place(begin), b = place(end); vec2 along = (b.xy - a.xy) / pixel;
  vec2 normal = length(along) > 0.0 ? normalize(vec2(-along.y, along.x)) : vec2(0.0);
  gl_Position = gl_VertexID > 1 ? b : a; gl_Position.z -= 0.003; beyond = side(gl_VertexID > 1 ? end : begin);
  gl_Position.xy += normal * pixel * width * (float(gl_VertexID & 1) - 0.5); }`, `
uniform vec3 plain; out vec4 color; void main() { if (beyond > 0.0) discard; color = vec4(plain, 1.0); }`),
};

function program(vertex, fragment) {
  const linked = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, "#version 300 es\nprecision highp float; in float beyond;" + fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(linked, shader);
  }
  gl.linkProgram(linked);
  if (!gl.getProgramParameter(linked, gl.LINK_STATUS)) throw Error(gl.getProgramInfoLog(linked));
  const known = {};
  return {linked, at: name => known[name] ??= gl.getUniformLocation(linked, name),
    attribute: name => known["in " + name] ??= gl.getAttribLocation(linked, name)};
}

function buffer(kind, values, filled = gl.createBuffer()) {
  gl.bindBuffer(kind, filled); gl.bufferData(kind, values, gl.STATIC_DRAW);
  return filled;
}

function attribute(used, name, source, size, type = gl.FLOAT, stride = 0, offset = 0, divisor = 0) {
  const at = used.attribute(name);
  gl.bindBuffer(gl.ARRAY_BUFFER, source); gl.enableVertexAttribArray(at);
  gl.vertexAttribPointer(at, size, type, type === gl.UNSIGNED_BYTE, stride, offset); gl.vertexAttribDivisor(at, divisor);
}

const start = {azimuth: 0.656, elevation: 0.452, zoom: 1, x: 0, y: 0};
const gap = 15;  // pixels between contacts that are drawn, in the mean, so that colours are seen between
// Cuts everything with dot(normal, p) > offset off; the zero vector cuts nothing.
const cutting = {normal: [0, 0, 0], offset: 0};
let eye = {...start}, frame = 0;

function turned() {  // columns of a mat3: the world's axes as the viewer sees them; z stays upright
  const [c, s, e, u] = [Math.cos(eye.azimuth), Math.sin(eye.azimuth), Math.cos(eye.elevation), Math.sin(eye.elevation)];
  return [c, -s * u, s * e, s, c * u, -c * e, 0, e, u];
}

function measures() {  // of the space beside panel and player, in CSS pixels; `unit` of them are one unit of length
  const w = canvas.clientWidth, h = canvas.clientHeight, beside = w > narrow;
  const left = beside ? panel.offsetWidth + 20 : 0, top = beside ? 0 : panel.offsetTop + panel.offsetHeight;
  const bottom = dock.hidden ? 0 : dock.offsetHeight + 16;
  // the scale lies beside the body, or below it
  const wide = Math.max(40, w - left), high = Math.max(40, h - top - bottom - (beside ? 0 : 2.5 * fontSize()));
  const unit = eye.zoom * 0.94 * Math.min(wide, high) / (2 * data.radius);
  const x = left + wide / 2 + eye.x, y = top + high / 2 - eye.y;
  const scale = [2 * unit / w, 2 * unit / h], shift = [2 * x / w - 1, 1 - 2 * y / h];
  return {w, h, left, bottom, wide, high, unit, x, y, scale, shift};
}

function onScreen(points) {  // of each point x and y in CSS pixels, and the depth, larger nearer to the viewer
  const m = turned(), view = measures(), placed = new Float64Array(points.length);
  for (let k = 0; k < points.length; k += 3) {
    const [a, b, c] = [points[k], points[k + 1], points[k + 2]];
    placed[k] = view.x + (m[0] * a + m[3] * b + m[6] * c) * view.unit;
    placed[k + 1] = view.y - (m[1] * a + m[4] * b + m[7] * c) * view.unit;
    placed[k + 2] = m[2] * a + m[5] * b + m[8] * c;
  }
  return placed;
}

function use(kind, view, cuts = true) {
  const used = programs[kind];
  gl.useProgram(used.linked);
  gl.uniformMatrix3fv(used.at("turn"), false, turned());
  gl.uniform2fv(used.at("scale"), view.scale); gl.uniform2fv(used.at("shift"), view.shift);
  gl.uniform1f(used.at("depth"), 0.2 / data.radius);
  gl.uniform4f(used.at("cut"), ...(cuts ? cutting.normal : [0, 0, 0]), cuts ? cutting.offset : 0);
  for (let k = 0; k < 4; k++) gl.disableVertexAttribArray(k);
  return used;
}

function drawPoints(layer, size, view, ratio, cuts = true, nearer = 0.004, count = layer.points.length / 3) {
  const used = use("points", view, cuts), pixels = Math.max(1, size * ratio);
  gl.uniform1f(used.at("size"), pixels); gl.uniform1f(used.at("nearer"), nearer);
  // points have a rim, which sets them off from what they lie on, unless they are too small
  gl.uniform1f(used.at("core"), pixels < 5 ? 2 : (1 - 2 * Math.max(1, 0.8 * ratio) / pixels) ** 2);
  attribute(used, "position", layer.buffer, 3, gl.FLOAT, 12);
  if (layer.tint) attribute(used, "tint", layer.tint, 3, gl.UNSIGNED_BYTE, 4);
  else gl.vertexAttrib3f(used.attribute("tint"), ...rgb(layer.color));
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, layer.elements || null);
  if (layer.elements) gl.drawElements(gl.POINTS, count, gl.UNSIGNED_INT, 0); else gl.drawArrays(gl.POINTS, 0, count);
}

function drawLines(layer, view, ratio, cuts = true) {
  const used = use("lines", view, cuts);
  gl.uniform2f(used.at("pixel"), 2 / canvas.width, 2 / canvas.height);
  gl.uniform1f(used.at("width"), layer.width * ratio * Math.min(2, Math.max(1, Math.sqrt(eye.zoom))));
  gl.uniform3fv(used.at("plain"), rgb(layer.color));
  for (let k = 0; k + 1 < layer.starts.length; k++) {
    attribute(used, "begin", layer.buffer, 3, gl.FLOAT, 12, 12 * layer.starts[k], 1);
    attribute(used, "end", layer.buffer, 3, gl.FLOAT, 12, 12 * layer.starts[k] + 12, 1);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, layer.starts[k + 1] - layer.starts[k] - 1);
  }
}

function drawTriangles(layer, view, level) {
  const used = use("triangles", view), transparent = layer.alpha < 1;
  const {elements, faces} = level ? layer.coarse ||= coarser(layer) : layer;
  attribute(used, "position", layer.buffer, 3); attribute(used, "tint", layer.tint, 3, gl.UNSIGNED_BYTE, 4);
  gl.uniform1f(used.at("alpha"), layer.alpha || 1);
  if (transparent) { gl.enable(gl.BLEND); gl.depthMask(false); }
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, elements);
  gl.drawElements(gl.TRIANGLES, faces.length, gl.UNSIGNED_INT, 0);
  if (transparent) { gl.disable(gl.BLEND); gl.depthMask(true); }
}

function coarser(layer) {  // the triangles that remain where all vertices in a cell of a grid become one of them
  const p = layer.points, cell = data.radius / 18, first = new Map(), chosen = new Uint32Array(p.length / 3);
  for (let k = 0; k < chosen.length; k++) {
    const key = [0, 1, 2].reduce((sum, i) => sum * 1024 + Math.round(p[3 * k + i] / cell) + 512, 0);
    if (!first.has(key)) first.set(key, k);
    chosen[k] = first.get(key);
  }
  const faces = [];
  for (let k = 0; k < layer.faces.length; k += 3) {
    const [a, b, c] = [0, 1, 2].map(i => chosen[layer.faces[k + i]]);
    if (a !== b && b !== c && c !== a) faces.push(a, b, c);
  }
  return {faces, elements: buffer(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(faces))};
}

// How many contacts, in their order, are drawn.
const seen = (layer, view) => Math.min(layer.order.length, Math.ceil(5 * (view.unit * data.radius / gap) ** 2));

function drawLayers(view, ratio, level) {
  gl.viewport(0, 0, canvas.width, canvas.height);
  gl.clearColor(...rgb(paperOrInk("paper")), 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT); gl.enable(gl.DEPTH_TEST);
  gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);  // the picture is opaque
  for (const layer of data.layers) {
    if (!layer.on || layer.alpha < 1) continue;
    if (layer.kind === "lines") drawLines(layer, view, ratio);
    else if (layer.kind === "triangles") drawTriangles(layer, view, level);
    else drawPoints(layer, eye.zoom > 1 ? 9 : 6, view, ratio, true, 0.004, layer.shown = seen(layer, view));
  }
  if (player) drawRod(view, ratio);
  for (const layer of data.layers) if (layer.on && layer.alpha < 1) drawTriangles(layer, view, level);
}

const pace = {asked: 0, lateFrames: 0, level: 0, settle: 0};

function draw(level = 0) {
  frame = 0;
  const ratio = ratios[level], view = measures();
  const width = Math.max(1, Math.round(view.w * ratio)), height = Math.max(1, Math.round(view.h * ratio));
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  cut();
  drawLayers(view, ratio, level);
  drawMarks(view, window.devicePixelRatio || 1);
}

function redraw() {
  if (frame) return;
  pace.asked = performance.now();
  frame = requestAnimationFrame(() => {  // three late frames in a row take pixels, which return when the picture is still
    pace.lateFrames = performance.now() - pace.asked > 36 ? pace.lateFrames + 1 : 0;
    if (pace.lateFrames >= 3) { pace.level = Math.min(ratios.length - 1, pace.level + 1); pace.lateFrames = 0; }
    draw(pace.level);
    clearTimeout(pace.settle);
    if (pace.level) pace.settle = setTimeout(draw, 200);
  });
}
