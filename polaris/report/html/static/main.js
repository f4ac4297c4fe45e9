// What is chosen (time, run, pilots, layers), the controls that choose it, and keeping all of the page in step.

const LAPSE = 24; // seconds in which playing shows a whole flight
const GROUPS = { unsafe: "unsafe sets", goal: "goal", initial: "initial set", reference: "safe reference",
  slice: "recoverable set (of the run under Polaris)", tube: "reachable set", sun: "sun", keep: "keep-in sphere", predicted: "predicted backup flights" };
const SWATCH = { unsafe: "#C0202B", goal: "#009E73", initial: "#404040", reference: "#767676", slice: "#E3D63B",
  tube: "#56B4E9", sun: "#E69F00", keep: "#767676", predicted: "#56B4E9" };

const $ = (id) => document.getElementById(id);
const ROUND_OFF = 1e-12; // below this is what rounding leaves of a zero
const short = (value) => {
  if (value === null || value === undefined) return "none";
  if (Math.abs(value) < ROUND_OFF) return "0";
  return Math.abs(value) < 1e-3 ? Number(value).toExponential(2) : String(Number(Number(value).toPrecision(4)));
};
const runOf = (pilot, state) => Math.max(pilot.labels.indexOf(state.run), 0);

function element(tag, properties, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function start() {
  document.querySelectorAll("table.sortable").forEach(sortable);
  const data = JSON.parse($("data").textContent);
  if (!data.scene) return;
  const state = { t: 0, run: data.pilots[0].labels[0], shown: data.pilots.filter((one) => one.on), playing: false,
    groups: new Set(data.scene.layers.map((layer) => layer.group)), always: false };
  const scene = $("scene"), timelines = $("timelines");
  // Only these buttons: plotly has others that send data away.
  const buttons = data.scene.space === 3 ? ["toImage", "zoom3d", "pan3d", "orbitRotation", "tableRotation", "resetCameraDefault3d"]
    : ["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"];
  const options = { responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: "", modeBarButtons: [buttons] };
  const layout = sceneLayout(data, scene);
  let wanted = false, drawing = false, untouched = true;

  // The scene is drawn at most once per frame, and not again before the last drawing is done.
  function drawScene() {
    wanted = true;
    if (drawing) return;
    drawing = true;
    requestAnimationFrame(async () => {
      wanted = false;
      await paintScene();
      drawing = false;
      if (wanted) drawScene();
    });
  }

  async function paintScene() {
    const { traces, names, marks } = sceneParts(data, state);
    const draw = (annotations) => Plotly.react(scene, themed(traces),
      themed({ ...layout, ...(data.scene.space === 3 ? { scene: { ...layout.scene, annotations } } : { annotations }) }), options);
    if (!scene._fullLayout) { // names are placed in what is drawn
      await draw([]);
      scene.on("plotly_relayout", drawScene);
    }
    await draw(annotationsOf(scene, data, names, marks));
  }

  async function drawTimelines() {
    const figure = timelineFigure(data, state);
    await Plotly.react(timelines, themed(figure.traces), themed(figure.layout), { ...options, displayModeBar: false });
  }

  function drawAgain() { // at once: no frame comes between an event and the paper
    recolour();
    paintScene();
    drawTimelines();
  }

  function setTime(t) {
    untouched = false;
    state.t = Math.min(Math.max(t, 0), data.end);
    $("time").value = state.t;
    $("time").setAttribute("aria-valuetext", `${short(state.t)} seconds`);
    $("now").textContent = `${state.t.toFixed(data.end < 100 ? 2 : 0)} s`;
    if (timelines.layout) Plotly.relayout(timelines, { "shapes[0].x0": state.t, "shapes[0].x1": state.t });
    readout(data, state);
    drawScene();
  }

  async function redraw() {
    drawScene();
    readout(data, state);
    await drawTimelines();
  }

  function play(on) {
    state.playing = on;
    $("play").textContent = on ? "Pause" : "Play";
    $("play").setAttribute("aria-pressed", String(on));
    if (!on) return;
    if (state.t >= data.end || untouched) setTime(0); // from the start, not from where the page opens
    let before = performance.now();
    const next = (now) => {
      if (!state.playing) return;
      if (!drawing) {
        const passed = Math.min((now - before) / 1000, 0.25); // a slow machine slows the flight down instead of leaping
        setTime(state.t + passed * (data.end / LAPSE));
        before = now;
      }
      if (state.t >= data.end) play(false); else requestAnimationFrame(next);
    };
    requestAnimationFrame(next);
  }

  controls(data, state, redraw);
  recolour();
  DARK.addEventListener("change", drawAgain);
  window.addEventListener("resize", drawTimelines); // titles are broken into lines that fit
  [["beforeprint", true], ["afterprint", false]].forEach(([name, on]) => window.addEventListener(name, () => {
    const before = isDark();
    printing = on;
    if (isDark() !== before) drawAgain();
  }));
  Object.assign($("time"), { min: 0, max: data.end, step: data.end / 1000, value: 0 });
  $("time").addEventListener("input", () => { play(false); setTime(snapped(data, Number($("time").value))); });
  $("play").addEventListener("click", () => play(!state.playing));
  setTime(data.open || 0);
  untouched = true;
  drawTimelines().then(() => {
    const at = (event) => event.xvals ? event.xvals[0] : event.points[0].x;
    // Moving the line makes plotly report the resting pointer again: only a new place counts.
    let pointed = null;
    timelines.on("plotly_hover", (event) => {
      if (state.playing || at(event) === pointed) return;
      pointed = at(event);
      setTime(snapped(data, pointed));
    });
    timelines.on("plotly_click", (event) => { play(false); setTime(snapped(data, at(event))); });
  });
}

function controls(data, state, redraw) {
  const tick = (name, checked, colour, change) => {
    const box = element("input", { type: "checkbox", checked });
    box.addEventListener("change", () => change(box));
    const swatch = element("span", { className: "swatch" });
    swatch.dataset.colour = colour;
    return element("label", {}, box, swatch, name);
  };
  data.pilots.forEach((pilot) => $("pilots").append(tick(pilot.name, pilot.on, pilot.colour, (box) => {
    pilot.on = box.checked;
    if (!data.pilots.some((one) => one.on)) { pilot.on = box.checked = true; return; }
    state.shown = data.pilots.filter((one) => one.on);
    redraw();
  })));
  const labels = [...new Set(data.pilots.flatMap((pilot) => pilot.labels))];
  labels.forEach((label) => $("run").append(element("option", { value: label, textContent: label })));
  $("run").addEventListener("change", () => { state.run = $("run").value; redraw(); });
  $("run").closest("label").hidden = labels.length < 2;
  const where = data.by === "pilot" && data.pilots.length > 1 ? " (first diagram)" : "";
  $("modes").append(element("li", { className: "quiet", textContent: `${data.modes_title}${where}:` }));
  data.modes.forEach((mode) => {
    const swatch = element("span", { className: "swatch" });
    swatch.dataset.colour = mode.colour;
    $("modes").append(element("li", {}, swatch, mode.name));
  });
  [...state.groups].forEach((group) => $("groups").append(tick(GROUPS[group] || group, true, SWATCH[group] || "#767676", (box) => {
    if (box.checked) state.groups.add(group); else state.groups.delete(group);
    redraw();
  })));
  if (state.groups.has("tube")) {
    $("groups").append(tick("reachable set at all times, not only now", false, SWATCH.tube, (box) => { state.always = box.checked; redraw(); }));
  }
}

// The same in words: one row per pilot with all values at the time shown.
function readout(data, state) {
  const own = data.panels.filter((panel) => panel.series.some((one) => one.pilot !== null));
  const heads = ["Shown", "Run", data.modes_title, ...own.map((panel) => panel.title + (panel.unit ? ` (${panel.unit})` : ""))];
  const head = element("tr", {}, ...heads.map((text) => element("th", { scope: "col", textContent: text })));
  const rows = state.shown.map((pilot) => {
    const run = runOf(pilot, state), [i, s] = place(pilot.t, state.t), who = pilot.runs[run].modes;
    const mode = data.modes.find((one) => one.mode === who[Math.min(i, who.length - 1)]);
    const cells = own.map((panel) => {
      const series = panel.series.find((one) => one.pilot === pilot.key);
      return series ? at(series, valuesOf(series, pilot, state), i, s) : "none";
    });
    const values = [pilot.labels[run], mode.name, ...cells].map((text) => element("td", { textContent: text }));
    values.forEach((cell, k) => { cell.dataset.head = heads[k + 1]; });
    return element("tr", {}, element("th", { scope: "row", textContent: pilot.name }), ...values);
  });
  $("readout").replaceChildren(element("thead", {}, head), element("tbody", {}, ...rows));
  const notes = data.panels.flatMap((panel) => panel.series.filter((one) => one.pilot === null).map((series) => {
    const [i, s] = place(series.t, series.bars ? state.t + series.width / 2 : state.t);
    if (series.text) return `${panel.title}: ${series.text[i]}`;
    return `${panel.title}, ${series.name}${series.meaning ? ", " + series.meaning : ""}: ${at(series, series.y, i, s)}${panel.unit ? " " + panel.unit : ""}`;
  }));
  const slice = state.groups.has("slice") && sliceAt(data, state);
  if (slice) notes.push(slice.p ? `Recoverable set drawn: at ${short(slice.t)} s${slice.now ? "" : ", not at the time shown"}`
    : `Recoverable set at ${short(slice.t)} s: not drawn, because the run shown is outside of it`);
  $("notes").replaceChildren(...notes.map((text) => element("li", { textContent: text })));
}

function at(series, values, i, s) {
  const held = series.step || series.bars || s === 0 || values[i + 1] === null || values[i] === null;
  return short(held ? values[i] : between(values, i, s));
}

start();
