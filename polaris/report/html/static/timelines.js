// Diagrams over time, one above the other with one time axis, and the line that marks the time shown.

const PANEL = 104, ROW = 22, LINE = 16, LIMIT = "#555555";

function rowsOf(data, state) {
  return state.shown.map((pilot) => plain(pilot.name));
}

// Who flies when: a bar from each change of mode to the next.
function modeTraces(data, state, yaxis) {
  const bars = new Map(data.modes.map((one) => [one.mode, { x: [], base: [], y: [], text: [] }]));
  for (const pilot of state.shown) {
    const who = pilot.runs[runOf(pilot, state)].modes, t = pilot.t;
    for (let i = 0, from = 0; i < who.length; i++) {
      if (i + 1 < who.length && who[i + 1] === who[i]) continue;
      const bar = bars.get(who[i]);
      bar.base.push(t[from]);
      bar.x.push(t[i + 1] - t[from]);
      bar.y.push(plain(pilot.name));
      bar.text.push(`${short(t[from])} to ${short(t[i + 1])} s`);
      from = i + 1;
    }
  }
  return data.modes.map((mode) => ({ type: "bar", orientation: "h", ...bars.get(mode.mode), textposition: "none",
    name: plain(mode.name), marker: { color: mode.colour, line: { width: 0 } }, yaxis, xaxis: "x", width: 0.7,
    hovertemplate: `%{y}: ${plain(mode.name)}<br>%{text}<extra></extra>` }));
}

function lineTraces(data, state, panel, yaxis) {
  const traces = [];
  for (const series of panel.series) {
    const pilot = series.pilot === null ? null : state.shown.find((one) => one.key === series.pilot);
    if (series.pilot !== null && !pilot) continue;
    const x = series.t || pilot.t, name = plain(series.name || pilot.name), unit = plain(panel.unit || "");
    const hover = `${name}${series.meaning ? ", " + plain(series.meaning) : ""}: %{y:.4g} ${unit}<extra></extra>`;
    if (series.bars) {
      const colours = series.modes.map((mode) => (data.modes.find((one) => one.mode === mode) || {}).colour);
      traces.push({ type: "bar", x, y: series.y, width: series.width, text: series.text.map(plain), textposition: "none",
        marker: { color: colours, line: { color: colours, width: 1 } }, xaxis: "x", yaxis, // a margin near 0 is a line
        hovertemplate: "%{text}<extra></extra>" });
      continue;
    }
    const colour = series.colour || pilot.colour, dash = series.dash || (pilot ? pilot.dash : "solid");
    const shape = series.step ? "hv" : "linear";
    if (series.band) {
      const rim = { type: "scatter", mode: "lines", x, line: { width: 0, shape }, xaxis: "x", yaxis, hoverinfo: "skip" };
      traces.push({ ...rim, y: series.band[0] });
      traces.push({ ...rim, y: series.band[1], fill: "tonexty", fillcolor: faded(colour, 0.16) });
    }
    traces.push({ type: "scatter", mode: "lines", x, y: valuesOf(series, pilot, state), name, xaxis: "x", yaxis,
      line: { color: colour, width: series.fill ? 1.2 : 1.8, dash, shape }, hovertemplate: hover,
      ...(series.fill ? { fill: "tozeroy", fillcolor: faded(colour, 0.14) } : {}) });
  }
  return traces;
}

const valuesOf = (series, pilot, state) => (series.runs ? series.runs[runOf(pilot, state)] : series.y);

// The range of a panel: what is drawn, and its limits.
function rangeOf(panel, traces) {
  let low = Infinity, high = -Infinity;
  const see = (v) => { if (v !== null && v !== undefined) { low = Math.min(low, v); high = Math.max(high, v); } };
  for (const trace of traces) trace.y.forEach(see);
  panel.limits.forEach((one) => see(one.y));
  if (panel.series.some((one) => one.bars)) see(1);
  if (low > high) return [0, 1];
  const pad = 0.08 * (high - low) || 1;
  return [low - pad, high + pad];
}

// Parts in rows that are no wider than `most` [px]; each part is its text and how it is drawn.
function inRows(parts, gap, most, weight) {
  ruler.font = `${weight} ${TYPE}px system-ui, sans-serif`;
  const rows = [], width = (row) => ruler.measureText(row.map((one) => one.text).join(gap)).width;
  for (const part of parts) {
    const last = rows[rows.length - 1];
    if (last && width([...last, part]) <= most) last.push(part); else rows.push([part]);
  }
  return rows.map((row) => row.map((one) => one.html).join(gap));
}

// The title of a diagram, and under it names of the lines that belong to no pilot and of limits that shade nothing.
function headOf(title, panel, most) {
  const bold = inRows(title.split(" ").map((text) => ({ text, html: plain(text) })), " ", most, "bold");
  const own = panel ? panel.series.filter((one) => one.pilot === null && !one.bars) : [];
  const limits = panel ? panel.limits.filter((one) => one.text && !one.unsafe).map((one) => ({ colour: LIMIT, name: one.text })) : [];
  const lines = [...own, ...limits].map(({ colour, name }) => (
    { text: `━━ ${name}`, html: `<span style="color:${colour}">━━</span> ${plain(name)}` }));
  return [...bold.map((line) => `<b>${line}</b>`), ...inRows(lines, "   ", most, "normal")];
}

function timelineFigure(data, state) {
  const narrow = isNarrow(), marks = (data.marks || []).map((one) => plain(one.text));
  const rows = rowsOf(data, state), heights = [ROW * rows.length + 8, ...data.panels.map(() => PANEL)];
  const small = narrow ? 9 : 11; // size of type of the names of who flies, which stand left of the diagrams
  ruler.font = `${small}px system-ui, sans-serif`;
  const left = Math.max(narrow ? 62 : 78, ...rows.map((name) => ruler.measureText(name).width + 12));
  const most = $("timelines").clientWidth - left - 12;
  const titles = [headOf(data.modes_title, null, most), ...data.panels.map((panel) => headOf(panel.title + (panel.unit ? ` (${panel.unit})` : ""), panel, most))];
  if (narrow) titles[0].push(...marks);
  const gaps = titles.map((lines) => 30 + LINE * Math.max(lines.length - 1, 1));
  const total = heights.reduce((sum, h, n) => sum + h + gaps[n], 0);
  const layout = { height: total + 46, margin: { l: left, r: 12, t: 4, b: 44 }, barmode: "overlay", hovermode: "x",
    hoverdistance: -1, showlegend: false, paper_bgcolor: "#fff", plot_bgcolor: "#fff", dragmode: narrow ? false : "zoom",
    font: { family: "system-ui, sans-serif", size: 11, color: "#222" }, uirevision: "keep", annotations: [],
    shapes: [{ type: "line", xref: "x", yref: "paper", x0: state.t, x1: state.t, y0: 0, y1: 1, line: { color: "#111", width: 1.5 } }],
    xaxis: { title: { text: "Time (s)" }, range: [0, data.end], gridcolor: "#E6E6E6", zeroline: false } };
  const traces = [];
  let top = total;
  titles.forEach((lines, n) => {
    const name = n ? "y" + (n + 1) : "y", yaxis = { gridcolor: "#E6E6E6", zeroline: false, nticks: 5, fixedrange: true };
    top -= gaps[n] - 14;
    layout.annotations.push({ text: lines.join("<br>"), align: "left", xref: "paper", yref: "paper", x: 0, y: top / total, xanchor: "left",
      yanchor: "bottom", showarrow: false, font: { size: 12 }, borderpad: 2 });
    yaxis.domain = [Math.max(top - heights[n], 0) / total, top / total];
    top -= heights[n] + 14;
    const own = n ? lineTraces(data, state, data.panels[n - 1], name) : modeTraces(data, state, name);
    if (n) {
      const panel = data.panels[n - 1];
      yaxis.range = rangeOf(panel, own);
      limitsOf(panel, yaxis.range, name, layout);
    } else Object.assign(yaxis, { type: "category", categoryarray: [...rows].reverse(), range: [-0.6, rows.length - 0.4], nticks: 0, tickmode: "array", tickvals: rows,
      tickfont: { size: small }, showgrid: false });
    layout[n ? "yaxis" + (n + 1) : "yaxis"] = yaxis;
    traces.push(...own);
  });
  for (const one of data.marks || []) { // after the line of the time shown
    if (one.t <= data.end * 1.001) {
      layout.shapes.push({ type: "line", xref: "x", yref: "paper", x0: one.t, x1: one.t, y0: 0, y1: 1, line: { color: one.panel ? "#C0202B" : "#009E73", width: 1.5, dash: "dot" } });
    }
    const at = data.panels.findIndex((panel) => panel.key === one.panel);
    if (!narrow) layout.annotations.push({ text: plain(one.text), xref: "x", yref: "paper", x: Math.min(one.t, data.end),
      y: at < 0 ? 1 : layout["yaxis" + (at + 2)].domain[1], xanchor: "right", yanchor: "top", showarrow: false, font: { size: 11, color: at < 0 ? "#00694d" : "#C0202B" } });
  }
  layout.xaxis.anchor = data.panels.length ? "y" + (data.panels.length + 1) : "y";
  return { traces, layout };
}

function limitsOf(panel, [low, high], yref, layout) {
  for (const one of panel.limits) {
    layout.shapes.push({ type: "line", xref: "paper", yref, x0: 0, x1: 1, y0: one.y, y1: one.y, layer: "below",
      line: { color: one.unsafe ? "#C0202B" : LIMIT, width: 1 } });
    if (one.unsafe) {
      layout.shapes.push({ type: "rect", xref: "paper", yref, x0: 0, x1: 1, y0: one.y, y1: one.unsafe === "below" ? low : high,
        layer: "below", line: { width: 0 }, fillcolor: "rgba(192,32,43,0.12)" });
    }
    if (one.text && one.unsafe) {
      layout.annotations.push({ text: plain(one.text), xref: "paper", yref, x: 1, y: one.y, xanchor: "right", showarrow: false,
        yanchor: one.unsafe === "below" ? "top" : "bottom", font: { size: 10, color: "#A01822" } });
    }
  }
}
