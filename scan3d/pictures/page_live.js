// Contacts that are found while the page is open, of the program that serves it.
async function follow() {
  const said = panel.querySelector(".headline"), first = data.layers.find(layer => layer.scale);
  let text;
  try { text = await (await fetch("data")).text(); }
  catch { said.textContent = said.textContent.replace(/^\w+, /, "") + ": the program that served this page has ended"; return; }
  const fresh = parsed(text);
  data.radius = Math.max(data.radius, fresh.radius);
  for (const now of fresh.layers) {
    const layer = data.layers.find(({name}) => name === now.name);
    if (!layer) continue;
    Object.assign(layer, now, {on: layer.on}); prepare(layer);
    if (layer.legend) legend(layer.legend, layer);
  }
  said.textContent = fresh.live;
  if (first) brief(first);
  redraw();
  setTimeout(follow, 250);
}

if (gl) follow();
