// The bent rod of a sample: its elastic line is integrated from the reactions at the clamp, in rod lengths.
// Steps of the integration along the whole rod; its error, of the fourth order, is below a pixel by far.
const rodSteps = 64;

// φ' = κ, κ' = f0y cos φ - f0x sin φ from the clamp, φ = π/2 and κ = -m0z, to the contact, κ = 0; straight from there.
function elasticLine(fx, fy, m) {
  const points = [[0, 0]], curvatureRate = phi => fy * Math.cos(phi) - fx * Math.sin(phi);
  const rate = ([, , phi, kappa]) => [Math.cos(phi), Math.sin(phi), kappa, curvatureRate(phi)];
  const move = (y, k, t) => y.map((v, i) => v + t * k[i]);
  let state = [0, 0, Math.PI / 2, -m], s = 0, contact = 0;
  const step = h => {
    const a = rate(state), b = rate(move(state, a, h / 2)), c = rate(move(state, b, h / 2)), d = rate(move(state, c, h));
    return state.map((v, i) => v + h / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]));
  };
  const bent = m !== 0;
  for (let k = 0; bent && k < rodSteps; k++) {
    let h = 1 / rodSteps, next = step(h);
    const ends = next[3] * m >= 0;  // κ has changed its sign
    for (let i = 0; ends && i < 4; i++) {  // Newton's method for the step at whose end it is zero
      h = Math.min(1 / rodSteps, Math.max(0, h - next[3] / curvatureRate(next[2]))); next = step(h);
    }
    state = next; s += h; points.push(state.slice(0, 2));
    if (ends) break;
  }
  if (bent) contact = points.length - 1;
  points.push([state[0] + (1 - s) * Math.cos(state[2]), state[1] + (1 - s) * Math.sin(state[2])]);
  return {points, contact, s1: s};
}

function clampAxes(k) {  // x, y and z of the clamp at a sample, in the world
  let low = 0, high = player.turned.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (player.turned[middle] <= k) low = middle; else high = middle - 1;
  }
  const [w, x, y, z] = player.turns.subarray(4 * low, 4 * low + 4);
  return [[1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]];
}

const clampAt = k => [...player.position.subarray(3 * k, 3 * k + 3)];

// The rod of a sample in the world: points from the clamp to the tip, of which number `contact` touches; reactions as vectors.
function rodAt(k) {
  const [x, y, z] = clampAxes(k), base = clampAt(k), size = player.width, L = player.length;
  const values = [...player.reactions.subarray(size * k, size * k + size)], angle = player.bending ? player.bending[k] : 0;
  const across = plus(x.map(v => v * Math.cos(angle)), z, Math.sin(angle));
  const [f, m] = size === 6 ? [values.slice(0, 3), values.slice(3)] : [[values[0], values[1], 0], [0, 0, values[2]]];
  const world = v => [0, 1, 2].map(i => v[0] * x[i] + v[1] * y[i] + v[2] * z[i]);
  const touches = player.contactOf[k] >= 0;
  const line = touches ? elasticLine((f[0] * Math.cos(angle) + f[2] * Math.sin(angle)) / player.forceUnit,
    f[1] / player.forceUnit, (m[2] * Math.cos(angle) - m[0] * Math.sin(angle)) / player.momentUnit) : elasticLine(0, 0, 0);
  return {base, x, y, z, across, force: world(f), moment: world(m), contact: line.contact, s1: line.s1, touches, values,
    points: line.points.map(([u, v]) => plus(plus(base, across, L * u), y, L * v))};
}
