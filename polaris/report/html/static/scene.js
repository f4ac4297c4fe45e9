// The scene at one instant: a list of plotly traces made anew from the page's data and what is chosen.

const plain = (text) => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

// Index of the last sample at or before t, and how far t is on the way to the next one.
function place(times, t) {
  let low = 0, high = times.length - 1;
  if (t >= times[high]) return [high, 0];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle; else high = middle;
  }
  return [low, t <= times[low] ? 0 : (t - times[low]) / (times[low + 1] - times[low])];
}

const between = (values, i, s) => (s === 0 ? values[i] : values[i] * (1 - s) + values[i + 1] * s);

// Coordinates and triangles of a layer at t; null while nothing of it is there.
function shapeAt(layer, t) {
  if (!layer.t) return layer;
  if (t < layer.t[0]) return null;
  const [i, s] = place(layer.t, t), shape = layer.frames ? layer.frames[i] : layer;
  if (!shape.p.length || !layer.shift) return shape.p.length ? shape : null;
  return { p: shape.p.map((axis, k) => axis.map((v) => v + between(layer.shift[k], i, s))), f: shape.f };
}

// The last slice of the run shown at or before t, without `p` if the run was outside; and whether it is of t itself.
function sliceAt(data, state) {
  const layer = data.scene.layers.find((one) => one.kind === "slice");
  const pilot = layer && state.shown.find((one) => one.key === layer.pilot), t = state.t + 1e-6 * data.end;
  if (!pilot || t < layer.t[0]) return null;
  const i = place(layer.t, t)[0], frame = (layer.frames[runOf(pilot, state)] || [])[i];
  return { ...frame, i, t: layer.t[i], now: t - layer.t[i] <= 2e-6 * data.end };
}

// The time of a slice, if one is nearer than half a step of the slider.
function snapped(data, t) {
  const layer = data.scene.layers.find((one) => one.kind === "slice");
  const near = layer ? layer.t.reduce((a, b) => (Math.abs(b - t) < Math.abs(a - t) ? b : a)) : t;
  return Math.abs(near - t) <= data.end / 2000 ? near : t;
}

// Filled at its own time, later dashed about the chaser's place of then; its time stands at it either way.
function sliceTraces(data, layer, state, names) {
  const last = sliceAt(data, state), found = last && last.p ? last : null;
  const { space, range } = data.scene, edge = "#8A7F00", none = [[], [], []];
  const name = found ? `recoverable at ${short(found.t)} s` : layer.name;
  const p = found ? [...found.p, found.p[0].map(() => found.at[2])].slice(0, space) : none, n = p[0].length - 1;
  const fan = [0, 1, 2].map((k) => Array.from({ length: Math.max(n - 2, 0) }, (_, j) => (k ? j + k : 0)));
  const now = found && found.now, cut = (v, k) => Math.min(Math.max(v, range[k][0]), range[k][1]);
  const foot = found && p.map((axis, k) => {
    const low = cut(Math.min(...axis), k), high = cut(Math.max(...axis), k);
    return k === 1 ? low : (low + high) / 2;
  });
  const look = (part) => ({ colour: edge, opacity: 1, uid: "slice" + part });
  if (found) names.push({ text: name, colour: edge, p: foot, below: true });
  return [...(last ? overTraces(data, layer, state, now && last.i, names) : []),
    traceOf(space, name, now ? { p, f: fan } : { p: none }, { ...layer, kind: space === 3 ? "mesh" : "area", uid: "slice" }),
    traceOf(space, name, { p }, { ...look("edge"), kind: "line", width: space === 3 ? 4 : 2, dash: now ? "solid" : "dash" }),
    traceOf(space, name + ": the chaser then", { p: found && !now ? found.at.map((v) => [v]) : none },
      { ...look("place"), kind: "points", size: 4, symbol: "circle-open" }),
  ];
}

// The sets in which the run shown is handed over, rimmed in the colour of who takes over; dashed but at their own times.
function overTraces(data, layer, state, now, names) {
  const { space, range } = data.scene, run = runOf(data.pilots.find((one) => one.key === layer.pilot), state);
  return layer.over.flatMap(([i, name, colour]) => {
    const frame = (layer.frames[run] || [])[i];
    if (!frame) return [];
    const p = [...frame.p, frame.p[0].map(() => frame.at[2])].slice(0, space), uid = "over" + i;
    const side = name.startsWith("S ") ? 0 : 1, end = p[side].indexOf(Math.max(...p[side])); // apart from one another
    names.push({ text: name, colour, p: p.map((axis, k) => Math.min(Math.max(axis[end], range[k][0]), range[k][1])) });
    return [traceOf(space, name + ": recoverable then", { p }, { kind: "line", colour, opacity: 1, width: space === 3 ? 3 : 1.5, dash: i === now ? "solid" : "dash", uid })];
  });
}

// All frames of a layer as one body, for a tube that is shown at all times.
function whole(layer) {
  const p = [[], [], []].slice(0, (layer.frames.find((frame) => frame.p.length) || { p: [] }).p.length);
  const f = [[], [], []];
  for (const frame of layer.frames) {
    if (!frame.p.length) continue;
    const from = p[0].length;
    frame.p.forEach((axis, k) => p[k].push(...axis, ...(frame.f ? [] : [null])));
    if (frame.f) frame.f.forEach((corner, k) => f[k].push(...corner.map((v) => v + from)));
  }
  return p.length && p[0].length ? { p, f: f[0].length ? f : undefined } : null;
}

function traceOf(space, name, shape, look) {
  const p = shape ? shape.p : [[], [], []];
  const common = { uid: look.uid, name: plain(name), showlegend: false, opacity: look.opacity };
  const hover = { hovertemplate: plain(name) + "<extra></extra>" };
  if (look.kind === "mesh") {
    const [i, j, k] = (shape && shape.f) || [[], [], []];
    const lighting = { ambient: 0.75, diffuse: 0.5, specular: 0.05, fresnel: 0 };
    return { type: "mesh3d", x: p[0], y: p[1], z: p[2] || [], i, j, k, color: look.colour, flatshading: true,
      lighting, visible: p[0].length > 0, ...common, ...hover };
  }
  const trace = space === 3 ? { type: "scatter3d", z: p[2] || [] } : { type: "scatter" };
  Object.assign(trace, { x: p[0], y: p[1] }, common, hover);
  if (look.kind === "points") {
    trace.mode = "markers";
    trace.marker = { color: look.colour, size: look.size * (space === 3 ? 1 : 2), symbol: look.symbol,
      line: { color: "#fff", width: 1 } };
    return trace;
  }
  trace.mode = "lines";
  trace.line = { color: look.colour, width: look.width || 1, dash: look.dash || "solid" };
  if (look.kind === "area") Object.assign(trace, { fill: "toself", fillcolor: faded(look.colour, look.opacity), opacity: 1 });
  return trace;
}

function faded(colour, share) {
  const [r, g, b] = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  return `rgba(${r},${g},${b},${share})`;
}

// What a pilot has flown by t, one path per mode with gaps, and where it is.
function flown(pilot, run, modes, t) {
  const { p, modes: who } = pilot.runs[run];
  const [last, s] = place(pilot.t, t);
  const paths = new Map(modes.map((one) => [one.mode, p.map(() => [])]));
  const here = p.map((axis) => between(axis, last, s));
  for (let i = 0; i <= last && i < who.length; i++) {
    const path = paths.get(who[i]);
    if (i === 0 || who[i - 1] !== who[i]) path.forEach((axis, k) => axis.push(p[k][i]));
    if (i < last) path.forEach((axis, k) => axis.push(p[k][i + 1]));
    else if (s > 0) path.forEach((axis, k) => axis.push(here[k]));
    if (i < last && who[i + 1] !== who[i]) path.forEach((axis) => axis.push(null));
  }
  return { paths, here };
}

// Traces of the scene, the names of what is in it, and the places of the chasers, which names must not cover.
function sceneParts(data, state) {
  const { space, layers } = data.scene, traces = [], names = [], marks = [];
  layers.forEach((layer, n) => {
    if (!state.groups.has(layer.group)) return;
    if (layer.kind === "slice") { traces.push(...sliceTraces(data, layer, state, names)); return; }
    const all = state.always && layer.group === "tube";
    const shape = all ? whole(layer) : shapeAt(layer, state.t);
    traces.push(traceOf(space, layer.name, shape, { ...layer, uid: "layer" + n }));
    if (layer.label && shape) {
      const p = shape.p.map((axis, k) => {
        const [first, last] = data.scene.range[k], cut = (v) => Math.min(Math.max(v, first), last);
        const low = cut(Math.min(...axis)), high = cut(Math.max(...axis));
        return k === space - 1 ? high : (low + high) / 2;
      });
      names.push({ text: layer.label, colour: "#8E1620", p });
    }
  });
  const byPilot = data.by === "pilot" && state.shown.length > 1;
  for (const pilot of state.shown) {
    const run = runOf(pilot, state), { paths, here } = flown(pilot, run, data.modes, state.t);
    const uid = "pilot" + pilot.key, wide = space === 3 ? 5 : 3;
    traces.push(traceOf(space, pilot.name + ", all of the run", { p: pilot.runs[run].p },
      { kind: "line", colour: byPilot ? pilot.colour : "#8A8A8A", opacity: 0.45, width: 1, dash: "solid", uid: uid + "all" }));
    for (const mode of data.modes) {
      const colour = byPilot ? pilot.colour : mode.colour;
      traces.push(traceOf(space, `${pilot.name}: ${mode.name}`, { p: paths.get(mode.mode) },
        { kind: "line", colour, opacity: 1, width: wide, dash: pilot.dash, uid: uid + mode.mode }));
    }
    const colour = pilot.colour;
    traces.push(traceOf(space, pilot.name + " now", { p: here.map((v) => [v]) },
      { kind: "points", colour, opacity: 1, size: 5, symbol: "circle", uid: uid + "now" }));
    marks.push(here);
  }
  return { traces, names, marks };
}

function sceneLayout(data, frame) {
  const { space, axes, range } = data.scene;
  const axis = (k) => ({ title: { text: plain(axes[k]), font: { size: 12 } }, range: range[k], autorange: false,
    gridcolor: "#E2E2E2", color: "#444", zeroline: false, tickfont: { size: 11 }, nticks: space === 3 && isNarrow() ? 4 : 6 });
  const common = { margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "#fff", uirevision: "keep", hovermode: "closest",
    font: { family: "system-ui, sans-serif", color: "#222" } };
  if (space === 2) {
    if (data.scene.equal) frame.style.aspectRatio = Math.max((range[0][1] - range[0][0]) / (range[1][1] - range[1][0]), 1);
    return { ...common, margin: { l: 60, r: 10, t: 10, b: 46 }, plot_bgcolor: "#fff", xaxis: axis(0),
      yaxis: { ...axis(1), ...(data.scene.equal ? { scaleanchor: "x" } : {}) } };
  }
  const size = range.map(([low, high]) => high - low), mean = Math.cbrt(size[0] * size[1] * size[2]);
  const ratio = size.map((v) => v / mean);
  frame.style.aspectRatio = seenFrom(ratio, 2).aspect;
  return { ...common, scene: { xaxis: axis(0), yaxis: axis(1), zaxis: axis(2), aspectmode: "manual",
    aspectratio: { x: ratio[0], y: ratio[1], z: ratio[2] }, camera: cameraFor(ratio, frame.clientWidth / frame.clientHeight) } };
}

const WAY = [0.36, -0.78, 0.51]; // to the eye, from the middle of the box
const HALF = Math.tan(Math.PI / 8); // of half the angle of view

// The corners of a box as seen from a distance (to the right, up, depth), how much room they take, and its aspect.
function seenFrom(ratio, far) {
  const along = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2], flat = Math.hypot(WAY[0], WAY[1]);
  const right = [-WAY[1] / flat, WAY[0] / flat, 0], length = Math.hypot(...WAY);
  const up = [-WAY[2] * right[1] / length, WAY[2] * right[0] / length, flat / length];
  const corners = [-0.5, 0.5].flatMap((x) => [-0.5, 0.5].flatMap((y) => [-0.5, 0.5].map((z) => [x * ratio[0], y * ratio[1], z * ratio[2]])));
  const points = corners.map((p) => {
    const depth = far - along(p, WAY);
    return [along(p, right) / depth, along(p, up) / depth, depth];
  });
  const size = [0, 1].map((k) => Math.max(...points.map((p) => p[k])) - Math.min(...points.map((p) => p[k])));
  return { points, size, right, up, aspect: size[0] / size[1] };
}

// The nearest camera, from one direction, for which a box and its labels fill the frame and are all within it.
function cameraFor(ratio, aspect) {
  // Titles of axes stand outside of the box, and are as large in a narrow window.
  const half = HALF, room = isNarrow() ? 0.62 : 0.8;
  let near = 0.1, far = 50;
  for (let i = 0; i < 40; i++) {
    const middle = (near + far) / 2, { points, size } = seenFrom(ratio, middle);
    const fits = points.every((p) => p[2] > 0.05) && size[0] <= 2 * room * half * aspect && size[1] <= 2 * room * half;
    if (fits) far = middle; else near = middle;
  }
  const { points, right, up } = seenFrom(ratio, far), mid = (k) => far * (Math.max(...points.map((p) => p[k])) + Math.min(...points.map((p) => p[k]))) / 2;
  const [a, b] = [mid(0), mid(1) - 0.04 * far * half];
  const shift = [0, 1, 2].map((k) => a * right[k] + b * up[k]);
  const point = (v) => ({ x: v[0], y: v[1], z: v[2] });
  return { eye: point(WAY.map((v, k) => v * far + shift[k])), center: point(shift), up: { x: 0, y: 0, z: 1 } };
}
