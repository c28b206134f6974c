"""A page of its own that shows a scan in any browser: one file, no network, WebGL 2 and nothing else."""

from __future__ import annotations

import base64
import html
import json
import re
from typing import Any

import numpy as np

from scan3d import scenes, stages, views
from scan3d.cloud import Array
from scan3d.errors import InputError
from scan3d.scenes import COLORS, Scene

# Colours of a scale that the page gets; it interpolates between them.
_STOPS = 33
# Bent states of the rod, and points on each.
_STATES = 9
_ROD_POINTS = 40


def page(scene: Scene) -> bytes:
    """The page (HTML, UTF-8) of a scene: its layers to switch, colours by values with their scales, and its key figures.

    The same scene gives the same bytes.  Raises InputError for a scene without anything to show.
    """
    if not len(scene.corners):
        raise InputError(f"{scene.name} has nothing to show: neither contacts nor a surface")
    corners = scene.corners
    center = (corners.min(axis=0) + corners.max(axis=0)) / 2
    with stages.quiet():
        layers = [layer for layer in _layers(scene, center) if layer is not None]
    data = {
        "unit": scene.unit.replace("um", "µm"),
        "center": center.tolist(),
        "radius": float(np.linalg.norm(corners - center, axis=1).max()) or 1.0,
        "layers": layers,
    }
    rows = "".join(f"<tr><th>{html.escape(what)}</th><td>{html.escape(much)}</td></tr>" for what, much in scene.figures)
    # "<" would end the script that the data stand in
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    filled = {"NAME": html.escape(scene.name), "FIGURES": rows, "DATA": text}
    # in one pass: what is filled in may look like a mark
    return re.sub("@([A-Z]+)@", lambda mark: filled[mark[1]], _PAGE).encode(errors="replace")


def _layers(scene: Scene, center: Array) -> list[dict[str, Any] | None]:
    """What can be switched on and off, drawn in this order."""
    return [_surface(scene, center), _contacts(scene, center), *_lines(scene, center), _truth(scene, center)]


def _surface(scene: Scene, center: Array) -> dict[str, Any] | None:
    if scene.surface is None:
        return None
    mesh, off, bound = scenes.shown_surface(scene)
    colors = []
    if off is not None:
        most = float(np.abs(off).max()) or 1.0
        colors.append(_scale(f"signed deviation in {scene.unit}", off, -most, most, "RdBu_r"))
    if bound is not None:
        colors.append(_scale(f"certified bound in {scene.unit}", bound, 0.0, float(np.nanmax(bound)) or 1.0, "YlGnBu"))
    return _triangles("surface", mesh, center, on=True, colors=colors)


def _truth(scene: Scene, center: Array) -> dict[str, Any] | None:
    if scene.truth is None:
        return None
    return _triangles("truth", scene.truth, center, color="#d98200", alpha=0.45)


def _triangles(name: str, mesh: Any, center: Array, **more: Any) -> dict[str, Any]:
    corners = np.asarray(mesh.vertices) - center
    return {
        "name": name,
        "kind": "triangles",
        "position": _floats(corners),
        "index": base64.b64encode(np.asarray(mesh.faces).astype("<u4").tobytes()).decode(),
        "color": "#c3ccd6",
        **more,
    }


def _contacts(scene: Scene, center: Array) -> dict[str, Any] | None:
    if scene.contacts is None:
        return None
    colors = []
    for color in COLORS:
        if scene.column(color) is None:
            continue
        shaded, values = views.shade_contacts(scene, color), scene.column(color)
        assert values is not None
        if shaded.norm is None:
            kinds = [["tangential", stages.TANGENTIAL], ["tip", stages.TIP]]
            colors.append({"title": "kind of contact", "kinds": kinds, "values": _floats(2 - values)})
        else:
            shown = values * 1e3 if color == "force" else values
            log = type(shaded.norm).__name__ == "LogNorm"
            low, high = float(shaded.norm.vmin), float(shaded.norm.vmax)
            colors.append(_scale(shaded.title, shown, low, high, shaded.map, log=log))
    names = {name: scene.column(name) for name in ("sweep", "slice")}
    told = {name: values.astype(int).tolist() for name, values in names.items() if values is not None}
    position = _floats(scene.points - center)
    return {"name": "contacts", "kind": "points", "on": True, "position": position, "colors": colors, "told": told,
            "color": stages.TANGENTIAL}  # fmt: skip


def _lines(scene: Scene, center: Array) -> list[dict[str, Any] | None]:
    """Normals, slices, and the rod along one sweep, where they are known."""
    found: list[dict[str, Any] | None] = []
    short = views.normals(scene)
    if len(short):
        found.append(_strips("normals", list(short), center, stages.NORMAL, 1.0))
    rings = [ring for ring, _ in scenes.rings(scene)]
    if rings:
        found.append(_strips("slices", rings, center, stages.INK, 1.2))
    if scene.recording is not None:
        one = scenes.sweep(scene, points=_ROD_POINTS)
        states = np.unique(np.linspace(0, len(one.base) - 1, _STATES).round().astype(int))
        rods = [np.concatenate([one.curved[k], one.straight[k, 1:]]) for k in states]
        found.append(_strips("rod in one sweep", [*rods, one.base[[0, -1]]], center, stages.ROD, 3.0))
    return found


def _strips(name: str, lines: list[Array], center: Array, color: str, width: float) -> dict[str, Any]:
    starts = np.cumsum([0, *map(len, lines)]).tolist()
    points = _floats(np.concatenate(lines) - center)
    return {"name": name, "kind": "lines", "position": points, "starts": starts, "color": color, "width": width}


def _scale(title: str, values: Array, low: float, high: float, map: str, *, log: bool = False) -> dict[str, Any]:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    stops = [to_hex(color) for color in colormaps[map](np.linspace(0, 1, _STOPS))]
    return {"title": title.replace(" um", " µm"), "values": _floats(values), "low": low, "high": high, "log": log,
            "stops": stops}  # fmt: skip


def _floats(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


_PAGE = r"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>@NAME@ – scan3d</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:">
<link rel="icon" href="data:,">
<style>
body { margin: 0; font: 14px/1.45 system-ui, sans-serif; color: #222; background: #fff; overflow: hidden }
canvas { position: fixed; inset: 0; width: 100vw; height: 100vh; touch-action: none; cursor: grab; outline: none }
#panel { position: fixed; top: 12px; left: 12px; width: 290px; max-width: calc(100vw - 48px); padding: 10px 14px;
 max-height: calc(100vh - 48px); overflow: auto; background: #fffffff0; border: 1px solid #ddd; border-radius: 6px;
 box-sizing: border-box }
summary { font-size: 17px; font-weight: 600; cursor: pointer }
table { border-collapse: collapse; margin: 6px 0 8px } td, th { padding: 1px 0; vertical-align: top; text-align: left }
th { font-weight: normal; color: #666; padding-right: 10px; white-space: nowrap } td { font-variant-numeric: tabular-nums }
label { display: block } select { max-width: 100%; margin: 2px 0 } .legend { margin: 2px 0 8px 22px; font-size: 12px }
.bar { height: 12px; border: 1px solid #999 } .ends { display: flex; justify-content: space-between }
.dot { display: inline-block; width: 10px; height: 10px; border-radius: 5px; margin-right: 5px }
#scale { position: fixed; right: 24px; bottom: 20px; border-bottom: 3px solid #222; text-align: center }
#told { position: fixed; right: 16px; top: 12px; padding: 6px 10px; background: #fffffff0; border: 1px solid #ddd;
 border-radius: 6px; white-space: pre; font-size: 13px } [hidden] { display: none !important }
.hint { color: #777; font-size: 12px; margin: 6px 0 0 }
</style></head><body>
<canvas id="view" tabindex="0" aria-label="the scan, turned by dragging"></canvas>
<details id="panel" open><summary>@NAME@</summary><table>@FIGURES@</table><div id="layers"></div>
<p class="hint">drag: turn · wheel or pinch: zoom · right button or two fingers: move · double click: back ·
click a contact: what was felt there</p></details>
<div id="scale"></div><div id="told" hidden></div>
<script type="application/json" id="data">@DATA@</script>
<script>
"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const canvas = document.getElementById("view"), told = document.getElementById("told");
const gl = canvas.getContext("webgl2", {antialias: true});
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer;
const rgb = hex => [1, 3, 5].map(k => parseInt(hex.slice(k, k + 2), 16) / 255);
const number = x => x === 0 ? "0" : Math.abs(x) >= 1e-3 && Math.abs(x) < 1e5 ? String(+x.toPrecision(3)) : x.toExponential(1);

const head = `#version 300 es
precision highp float; uniform mat3 turn; uniform vec2 scale, shift; uniform float depth;
vec4 place(vec3 p) { vec3 q = turn * p; return vec4(q.xy * scale + shift, -q.z * depth, 1.0); }`;
const programs = gl && {
  triangles: program(head + `
in vec3 position; in vec3 tint; out vec3 seen, shade;
void main() { seen = turn * position; shade = tint; gl_Position = place(position); }`, `
in vec3 seen, shade; uniform float alpha; out vec4 color;
void main() { vec3 n = normalize(cross(dFdx(seen), dFdy(seen)));
  float light = 0.5 + 0.5 * max(dot(n, normalize(vec3(0.25, 0.45, 0.86))), 0.0);
  color = vec4(shade * light, alpha); }`),
  points: program(head + `
in vec3 position; in vec3 tint; out vec3 shade; uniform float size;
void main() { shade = tint; gl_Position = place(position); gl_Position.z -= 0.004; gl_PointSize = size; }`, `
in vec3 shade; out vec4 color;
void main() { vec2 d = 2.0 * gl_PointCoord - 1.0; float r = dot(d, d); if (r > 1.0) discard;
  color = vec4(shade * (0.75 + 0.25 * sqrt(1.0 - r)), 1.0); }`),
  lines: program(head + `
in vec3 begin, end; uniform vec2 pixel; uniform float width;
void main() { vec4 a = place(begin), b = place(end); vec2 way = (b.xy - a.xy) / pixel;
  vec2 side = length(way) > 0.0 ? normalize(vec2(-way.y, way.x)) : vec2(0.0);
  gl_Position = gl_VertexID > 1 ? b : a; gl_Position.z -= 0.003;
  gl_Position.xy += side * pixel * width * (float(gl_VertexID & 1) - 0.5); }`, `
uniform vec3 flat_color; out vec4 color; void main() { color = vec4(flat_color, 1.0); }`),
};

function program(vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, "#version 300 es\nprecision highp float;" + fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw Error(gl.getProgramInfoLog(made));
  return made;
}

function buffer(kind, values) {
  const made = gl.createBuffer();
  gl.bindBuffer(kind, made); gl.bufferData(kind, values, gl.STATIC_DRAW);
  return made;
}

function attribute(of, name, from, size, type = gl.FLOAT, stride = 0, offset = 0, each = 0) {
  const at = gl.getAttribLocation(of, name);
  gl.bindBuffer(gl.ARRAY_BUFFER, from); gl.enableVertexAttribArray(at);
  gl.vertexAttribPointer(at, size, type, type === gl.UNSIGNED_BYTE, stride, offset); gl.vertexAttribDivisor(at, each);
}

function prepare(layer) {
  layer.points = new Float32Array(bytes(layer.position));
  layer.buffer = buffer(gl.ARRAY_BUFFER, layer.points);
  if (layer.index) {
    layer.faces = new Uint32Array(bytes(layer.index));
    layer.elements = buffer(gl.ELEMENT_ARRAY_BUFFER, layer.faces);
  }
  for (const one of layer.colors || []) one.values = new Float32Array(bytes(one.values));
  paint(layer, (layer.colors || [])[0]);
}

function share(one, value) {
  const f = one.log ? Math.log : x => x, inside = Math.min(one.high, Math.max(one.low, value));
  return (f(inside) - f(one.low)) / (f(one.high) - f(one.low));
}

function paint(layer, one) {
  const n = layer.points.length / 3, tint = new Uint8Array(4 * n), plain = rgb(layer.color), grey = [0.6, 0.6, 0.6];
  const stops = one && (one.stops || one.kinds.map(kind => kind[1])).map(rgb);
  for (let k = 0; k < n; k++) {
    let color = plain;
    if (one && one.kinds) color = stops[one.values[k]];
    else if (one && !isFinite(one.values[k])) color = grey;
    else if (one) {
      const at = share(one, one.values[k]) * (stops.length - 1), low = Math.min(Math.floor(at), stops.length - 2);
      color = stops[low].map((c, i) => c + (at - low) * (stops[low + 1][i] - c));
    }
    for (let i = 0; i < 3; i++) tint[4 * k + i] = Math.round(255 * color[i]);
  }
  layer.tint = buffer(gl.ARRAY_BUFFER, tint);
}

const start = {azimuth: 0.656, elevation: 0.452, zoom: 1, x: 0, y: 0};
let eye = {...start}, frame = 0;

function turned() {  // columns of a mat3: the world's axes as the viewer sees them; z stays upright
  const [c, s, e, u] = [Math.cos(eye.azimuth), Math.sin(eye.azimuth), Math.cos(eye.elevation), Math.sin(eye.elevation)];
  return [c, -s * u, s * e, s, c * u, -c * e, 0, e, u];
}

function measures() {
  const w = canvas.clientWidth, h = canvas.clientHeight, panel = document.getElementById("panel");
  const left = panel.open && w > 700 ? 310 : 0;  // keeps clear of the panel
  const unit = eye.zoom * 0.94 * Math.min(w - left, h) / (2 * data.radius);  // CSS pixels to the unit
  return {w, h, unit, scale: [2 * unit / w, 2 * unit / h], shift: [left / w + 2 * eye.x / w, 2 * eye.y / h]};
}

function draw() {
  frame = 0;
  const ratio = window.devicePixelRatio || 1, {w, h, unit, scale, shift} = measures();
  const wide = Math.max(1, Math.round(w * ratio)), tall = Math.max(1, Math.round(h * ratio));
  if (canvas.width !== wide || canvas.height !== tall) { canvas.width = wide; canvas.height = tall; }
  gl.viewport(0, 0, canvas.width, canvas.height);
  gl.clearColor(1, 1, 1, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT); gl.enable(gl.DEPTH_TEST);
  gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  for (const layer of data.layers) {
    if (!layer.on) continue;
    const one = programs[layer.kind], at = name => gl.getUniformLocation(one, name), n = layer.points.length / 3;
    gl.useProgram(one);
    gl.uniformMatrix3fv(at("turn"), false, turned());
    gl.uniform2fv(at("scale"), scale); gl.uniform2fv(at("shift"), shift); gl.uniform1f(at("depth"), 0.2 / data.radius);
    for (let k = 0; k < 4; k++) gl.disableVertexAttribArray(k);
    if (layer.kind === "lines") {
      gl.uniform2f(at("pixel"), 2 / canvas.width, 2 / canvas.height);
      gl.uniform1f(at("width"), layer.width * ratio * Math.min(2, Math.max(1, Math.sqrt(eye.zoom))));
      gl.uniform3fv(at("flat_color"), rgb(layer.color));
      for (let k = 0; k + 1 < layer.starts.length; k++) {
        attribute(one, "begin", layer.buffer, 3, gl.FLOAT, 12, 12 * layer.starts[k], 1);
        attribute(one, "end", layer.buffer, 3, gl.FLOAT, 12, 12 * layer.starts[k] + 12, 1);
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, layer.starts[k + 1] - layer.starts[k] - 1);
      }
      continue;
    }
    attribute(one, "position", layer.buffer, 3); attribute(one, "tint", layer.tint, 3, gl.UNSIGNED_BYTE, 4);
    if (layer.kind === "points") {
      gl.uniform1f(at("size"), ratio * Math.min(12, 4 * Math.sqrt(eye.zoom)));
      gl.drawArrays(gl.POINTS, 0, n);
    } else {
      const clear = layer.alpha < 1;
      gl.uniform1f(at("alpha"), layer.alpha || 1);
      if (clear) { gl.enable(gl.BLEND); gl.depthMask(false); }
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, layer.elements);
      gl.drawElements(gl.TRIANGLES, layer.faces.length, gl.UNSIGNED_INT, 0);
      if (clear) { gl.disable(gl.BLEND); gl.depthMask(true); }
    }
  }
  const most = 160 / unit, power = 10 ** Math.floor(Math.log10(most)), bar = document.getElementById("scale");
  const length = [5, 2, 1].find(k => k * power <= most) * power;
  bar.style.width = length * unit + "px"; bar.textContent = number(length) + " " + data.unit;
}
const redraw = () => { frame = frame || requestAnimationFrame(draw); };

function legend(place, one) {
  place.replaceChildren();
  if (!one) return;
  const add = (parent, kind, name, text = "") => {
    const made = parent.appendChild(document.createElement(kind));
    made.className = name; made.textContent = text;
    return made;
  };
  if (one.kinds) {
    for (const [text, color] of one.kinds) {
      const row = add(place, "div", ""); add(row, "span", "dot").style.background = color; row.append(text);
    }
    return;
  }
  add(place, "div", "bar").style.background = "linear-gradient(to right," + one.stops.join() + ")";
  const ends = add(place, "div", "ends");
  for (const value of one.log ? [one.low, one.high] : [one.low, (one.low + one.high) / 2, one.high]) {
    add(ends, "span", "", number(value));
  }
}

function controls() {
  const place = document.getElementById("layers");
  for (const layer of data.layers) {
    const label = place.appendChild(document.createElement("label")), box = document.createElement("input");
    box.type = "checkbox"; box.checked = !!layer.on; box.name = layer.name;
    box.onchange = () => { layer.on = box.checked; redraw(); };
    label.append(box, " " + layer.name);
    if (!(layer.colors || []).length) continue;
    const choice = document.createElement("select"), scale = document.createElement("div");
    choice.setAttribute("aria-label", "colour of " + layer.name); scale.className = "legend";
    for (const one of [...layer.colors, null]) choice.add(new Option(one ? one.title : "plain"));
    choice.onchange = () => {
      const one = layer.colors[choice.selectedIndex];
      paint(layer, one); legend(scale, one); redraw();
    };
    legend(scale, layer.colors[0]); place.append(choice, scale);
  }
  document.getElementById("panel").ontoggle = redraw;
}

function pick(x, y) {
  const layer = data.layers.find(one => one.kind === "points" && one.on), m = turned(), {w, h, scale, shift} = measures();
  let best = -1, front = -Infinity;
  const p = layer ? layer.points : [];
  for (let k = 0; k < p.length; k += 3) {
    const [u, v, d] = [0, 1, 2].map(i => m[i] * p[k] + m[3 + i] * p[k + 1] + m[6 + i] * p[k + 2]);
    const dx = (u * scale[0] + shift[0] + 1) * w / 2 - x, dy = (1 - v * scale[1] - shift[1]) * h / 2 - y;
    if (dx * dx + dy * dy < 36 && d > front) { best = k / 3; front = d; }
  }
  told.hidden = best < 0;
  if (best < 0) return;
  const place = [0, 1, 2].map(i => "xyz"[i] + " = " + (p[3 * best + i] + data.center[i]).toPrecision(6) + " " + data.unit);
  const rows = Object.entries(layer.told).map(([name, values]) => name + " " + values[best]);
  const felt = layer.colors.map(one => one.title + ": " + (one.kinds ? one.kinds[one.values[best]][0]
    : isFinite(one.values[best]) ? number(one.values[best]) : "unknown"));
  told.textContent = ["contact " + best, ...place, ...rows, ...felt].join("\n");
}

function zoom(factor) { eye.zoom = Math.min(200, Math.max(0.2, eye.zoom * factor)); redraw(); }
function turn(dx, dy) {
  eye.azimuth -= dx; eye.elevation = Math.min(1.5707, Math.max(-1.5707, eye.elevation + dy)); redraw();
}

function listen() {
  const down = new Map();
  let moved = 0;
  canvas.onpointerdown = e => {
    canvas.setPointerCapture(e.pointerId); canvas.focus(); down.set(e.pointerId, [e.clientX, e.clientY]); moved = 0;
  };
  canvas.onpointermove = e => {
    const last = down.get(e.pointerId);
    if (!last) return;
    const now = [e.clientX, e.clientY], dx = now[0] - last[0], dy = now[1] - last[1];
    moved += Math.abs(dx) + Math.abs(dy);
    if (down.size === 2) {
      const other = [...down.entries()].find(([id]) => id !== e.pointerId)[1];
      const apart = p => Math.hypot(p[0] - other[0], p[1] - other[1]);
      zoom(apart(now) / Math.max(1, apart(last)));
    }
    if (down.size === 2 || e.buttons & 6 || e.shiftKey) { eye.x += dx / down.size; eye.y -= dy / down.size; redraw(); }
    else turn(dx * 0.008, dy * 0.008);
    down.set(e.pointerId, now);
  };
  canvas.onpointerup = canvas.onpointercancel = e => {
    down.delete(e.pointerId);
    if (e.type === "pointerup" && moved < 4 && e.button === 0) pick(e.clientX, e.clientY);
  };
  canvas.addEventListener("wheel", e => { e.preventDefault(); zoom(Math.exp(-0.0012 * e.deltaY)); }, {passive: false});
  canvas.oncontextmenu = e => e.preventDefault();
  canvas.ondblclick = () => { eye = {...start}; redraw(); };
  canvas.onkeydown = e => {
    const step = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1]}[e.key];
    if (step) turn(...step); else if (e.key === "+") zoom(1.2); else if (e.key === "-") zoom(1 / 1.2);
  };
  window.onresize = redraw;
}

document.getElementById("panel").open = window.innerWidth > 600;
if (gl) {
  data.layers.forEach(prepare); controls(); listen(); draw();
} else {
  told.hidden = false; told.textContent = "This browser shows no WebGL 2, which the picture needs.";
}
</script></body></html>
"""
