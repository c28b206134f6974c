// What mouse, fingers and keys do, and the start of the page.

function zoom(factor) { eye.zoom = Math.min(200, Math.max(0.2, eye.zoom * factor)); redraw(); }
function turn(dx, dy) {
  eye.azimuth -= dx; eye.elevation = Math.min(1.5707, Math.max(-1.5707, eye.elevation + dy)); redraw();
}
function along(axis) {
  [eye.azimuth, eye.elevation] = {x: [Math.PI / 2, 0], y: [Math.PI, 0], z: [0, 1.5707]}[axis]; redraw();
}
let home = {...start};  // the view to which the page comes back, and in which it opens
const untouched = () => Object.keys(start).every(name => eye[name] === home[name]);
function reset() {
  eye = {...start};
  if (player?.on) lookAtSweep();
  home = {...eye}; redraw();
}
function escape() {
  if (marks.measuring) measuring(false);
  marks.points = []; marks.contact = -1; picked.hidden = true; redraw();
}

function step(sweeps, samples) {  // from the present sample
  play(false); switchPlayer(true);
  goTo(player.sweep + sweeps, player.sample - player.starts[player.sweep] + samples);
}

function listen() {
  // mouse and fingers
  const down = new Map();
  let moved = 0;
  canvas.onpointerdown = e => {
    canvas.classList.remove("keys"); canvas.focus(); canvas.setPointerCapture(e.pointerId);
    down.set(e.pointerId, [e.clientX, e.clientY]); moved = 0;
  };
  canvas.onpointermove = e => {
    const last = down.get(e.pointerId), now = [e.clientX, e.clientY];
    if (!last) return;
    const dx = now[0] - last[0], dy = now[1] - last[1];
    moved += Math.abs(dx) + Math.abs(dy);
    if (down.size === 2) {
      const other = [...down.entries()].find(([id]) => id !== e.pointerId)[1];
      const apart = p => Math.hypot(p[0] - other[0], p[1] - other[1]);
      zoom(apart(now) / Math.max(1, apart(last)));
    }
    if (down.size === 2 || e.buttons & 6 || e.shiftKey) { eye.x += dx / down.size; eye.y -= dy / down.size; redraw(); }
    else turn(0.008 * dx, 0.008 * dy);
    down.set(e.pointerId, now);
  };
  canvas.onpointerup = canvas.onpointercancel = e => {
    down.delete(e.pointerId);
    if (e.type === "pointerup" && moved < 4 && e.button === 0) click(e.clientX, e.clientY);
  };
  canvas.addEventListener("wheel", e => { e.preventDefault(); zoom(Math.exp(-0.0012 * e.deltaY)); }, {passive: false});
  canvas.oncontextmenu = e => e.preventDefault();
  canvas.ondblclick = reset;

  // keys
  const keys = {"+": () => zoom(1.2), "=": () => zoom(1.2), "-": () => zoom(1 / 1.2), 0: reset, Escape: escape};
  for (const axis of "xyz") keys[axis] = () => along(axis);
  if (player) {
    const present = () => player.contactOf[player.sample];
    const markContact = () => { if (present() >= 0) mark(contactPoint(present())); };
    Object.assign(keys, {",": () => step(0, -1), ".": () => step(0, 1), "[": () => step(-1, 0), "]": () => step(1, 0),
      p: () => play(), m: markContact});
  }
  canvas.onkeyup = () => canvas.classList.add("keys");  // the frame that says where the focus is; after Tab as well
  document.onkeydown = e => {  // wherever the focus is, but for keys that a control there uses itself
    const {tagName, type} = e.target, moves = /^(Arrow|Home|End|Page)/.test(e.key);
    if (e.ctrlKey || e.altKey || e.metaKey || tagName === "SELECT" && e.key !== "Escape" || type === "range" && moves) return;
    const way = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}[e.key];
    if (way && e.shiftKey) { eye.x += 20 * way[0]; eye.y += 20 * way[1]; }
    else if (way) turn(0.1 * way[0], 0.1 * way[1]);
    else if (keys[e.key]) keys[e.key]();
    else return;
    e.preventDefault(); redraw();
  };

  // buttons, boxes and sliders
  byId("cut-axis").onchange = byId("cut-at").oninput = byId("cut-flip").onchange = redraw;
  byId("measure").onclick = () => measuring(); byId("reset").onclick = reset;
  for (const button of document.querySelectorAll("[data-along]")) button.onclick = () => along(button.dataset.along);
  const arrange = () => {
    document.body.classList.toggle("with-panel", panel.open);
    if (player) player.stale = true;
    if (untouched()) reset();  // to the new space
    else redraw();
  };
  panel.ontoggle = window.onresize = matchMedia("(prefers-color-scheme: dark)").onchange = arrange;
  arrange();
  if (!player) return;
  byId("play").onclick = () => play();
  byId("charts").onclick = () => showCurves(curves.hidden);
  const slid = (sweep, sample) => { play(false); switchPlayer(true); goTo(sweep, sample); };
  byId("sweep").oninput = e => slid(+e.target.value, player.sample - player.starts[player.sweep]);
  byId("sample").oninput = e => slid(player.sweep, +e.target.value);
  curves.onpointerdown = curves.onpointermove = e => {
    if (e.buttons & 1) { play(false); goToSample(sampleAtCurve(e.clientX)); }
  };
}

panel.open = window.innerWidth > narrow && window.innerHeight > 500;
if (gl) {
  data.layers.forEach(prepare);
  if (player) preparePlayer();
  controls();
  byId("figures").hidden = !byId("figures").querySelector("td");
  byId("figures").open = true;  // where they fit
  byId("figures").open = panel.scrollHeight <= panel.clientHeight;
  listen(); draw();
  if (player) switchPlayer(true);
} else {
  picked.hidden = false; picked.textContent = "This browser does not support WebGL 2, which this page needs.";
}
